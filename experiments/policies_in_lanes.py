"""Several policies side by side: each drives its own flow of a batch, deterministically, without exploration."""

from collections.abc import Callable, Sequence

import numpy as np

from manywake.case.task import Task
from manywake.env.control import ControlledFlows, drive
from manywake.flow.store import Flow
from manywake.learn import policy as policies
from manywake.learn.policy import Policy

Look = Callable[[ControlledFlows], None]


def play(
    flow: Flow, task: Task, driving: Sequence[Policy | None], actions: int, look: Look = lambda flows: None
) -> dict[str, np.ndarray]:
    """Play a number of actions from the start state; None is no control. look: called after every action.

    Returns c_d, c_l and jet, the first one's flow rate, of every solver step (steps, B).
    """
    flows = ControlledFlows(flow, task, len(driving))
    still = np.zeros(flows.mixing.shape[1])

    def choose(t: int, seen: np.ndarray) -> np.ndarray:
        each = enumerate(driving)
        return np.stack([still if p is None else policies.act(p, seen[k : k + 1])[0] for k, p in each])

    outcomes = []
    for step in drive(flows, choose, actions):
        outcomes.append(step.outcome)
        look(flows)
    series = {name: np.concatenate([outcome.series[name] for outcome in outcomes]) for name in ("c_d", "c_l")}
    return series | {"jet": np.concatenate([outcome.amplitudes[:, 0] for outcome in outcomes])}
