"""Several policies side by side: each drives its own flow of a batch, deterministically, without exploration."""

from collections.abc import Callable, Sequence

import numpy as np

from manywake.env.task import ControlledFlow
from manywake.learn import evaluate
from manywake.learn import policy as policies
from manywake.learn.evaluate import Trajectory
from manywake.learn.policy import Policy
from manywake.learn.rollout import JetFlows

Look = Callable[[ControlledFlow], None]


def play(
    simulation: JetFlows, driving: Sequence[Policy | None], actions: int, look: Look = lambda flows: None
) -> Trajectory:
    """Play a number of actions from the start state; None is no control. look: called after every action."""
    flows = ControlledFlow(simulation.operators, simulation.baseline, simulation.task, len(driving))

    def act(seen: np.ndarray) -> np.ndarray:
        each = enumerate(driving)
        return np.array([0.0 if p is None else policies.act(p, seen[k : k + 1])[0, 0] for k, p in each])

    return evaluate.drive(flows, act, actions, look)
