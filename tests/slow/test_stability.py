"""No controller breaks a shipped flow: square waves of every period, random signs, random actions, at full limits."""

import numpy as np
import pytest

from manywake.env.control import ControlledFlows
from manywake.flow import store
from manywake.suite import load

PERIODS = range(4, 25)
"""In actions; the shedding period of the default is 13.3."""
PHASES, ACTIONS = 8, 160
CASES = [name for name in load.names() if load.load(name).task is not None]


def survivors(name, choose, flows):
    """Play `ACTIONS` with choose(t, actions of a flow) -> (B, actions); return which flows did not blow up."""
    chosen = load.choose(name)
    controlled = ControlledFlows(store.flow(chosen.case), chosen.task, flows)
    alive = np.ones(flows, bool)
    for t in range(ACTIONS):
        alive &= ~controlled.act(choose(t, controlled.mixing.shape[1])).diverged
    return alive


@pytest.mark.parametrize("name", CASES)
def test_no_flow_diverges_under_square_waves_of_any_period(name):
    each = [(period, k * period / PHASES, sign) for period in PERIODS for k in range(PHASES) for sign in (1.0, -1.0)]
    period, phase, sign = (np.array(part) for part in zip(*each, strict=True))

    def square(t, actions):
        # several actions: one after the other, a share of the period later each
        lag = np.arange(actions) / max(actions, 2)
        up = ((t + phase)[:, None] / period[:, None] + lag + 1e-9) % 1.0 < 0.5
        return sign[:, None] * np.where(up, 1.0, -1.0)

    assert survivors(name, square, len(each)).all()


@pytest.mark.parametrize("name", CASES)
def test_no_flow_diverges_under_actions_of_random_sign(name):
    rng = np.random.default_rng(0)
    assert survivors(name, lambda t, actions: rng.choice([-1.0, 1.0], (112, actions)), 112).all()


@pytest.mark.parametrize("name", CASES)
def test_no_flow_diverges_under_uniformly_random_actions(name):
    rng = np.random.default_rng(0)
    assert survivors(name, lambda t, actions: rng.uniform(-1, 1, (56, actions)), 56).all()
