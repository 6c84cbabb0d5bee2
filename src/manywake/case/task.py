"""The control task on a flow: when to act, how actions become amplitudes, what is observed and what is rewarded."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from manywake.case.laws import Held, Law

Means = Mapping[str, float]
"""Readings by name, each a mean over one action."""
Reward = Callable[[Means, Means], float]
"""reward(now, free): of an action's readings and those of the uncontrolled flow."""
Charge = Callable[[Reward, Sequence[Means], Means], float]
"""charge(reward, forced, free): what a flow that blew up is given for that action and each that was to come.

forced: readings of flows under the largest forcing, that of the case's stability run."""
Mixing = tuple[tuple[float, ...], ...]
STARTS = ("first", "any")

PAIR: Mixing = ((1.0,), (-1.0,))
"""One action for two inputs: what the first blows in the second sucks out."""


def pairs(count: int) -> Mixing:
    """Return the mixing of `count` pairs (1, 2), (3, 4), ...: an action for each pair, of zero net flux."""
    return tuple(tuple(sign * (k == pair) for k in range(count)) for pair in range(count) for sign in (1.0, -1.0))


def alike(count: int) -> Mixing:
    """Return the mixing of one action that all `count` inputs follow."""
    return ((1.0,),) * count


def balanced(count: int) -> Mixing:
    """Return the mixing of `count` actions whose mean is subtracted, so that the amplitudes have zero sum."""
    return tuple(tuple((row == k) - 1.0 / count for k in range(count)) for row in range(count))


def twice_the_worst(reward: Reward, forced: Sequence[Means], free: Means) -> float:
    """Charge twice what the worst of the forced flows loses against the uncontrolled flow: to stay is always better."""
    nothing = reward(free, free)
    return nothing - 2 * (nothing - min(nothing, *(reward(now, free) for now in forced)))


@dataclass(frozen=True)
class Task:
    """Settings of a control task. Times are in the case's unit."""

    interval: float
    """Time between actions, in the case's unit of time; a multiple of the time step."""
    actions: int
    """Actions of an episode, its horizon."""
    reward: Reward
    """Function reward(now, free) of the readings by name, each a mean over the action, now and without control."""
    observe: tuple[str, ...]
    """What the agent sees, in this order: sensors by name, readings by name (c_d, c_l.front, power), amplitudes."""
    mixing: Mixing | None = None
    """Matrix from actions to amplitudes, a row an input; scaled so that no row's absolute sum exceeds 1. Without one
    every input has an action of its own."""
    law: Law = Held()
    """How amplitudes follow what is wanted."""
    starts: str = "first"
    """Where episodes begin: "first" at the start state, "any" at one of several far apart that the seed draws."""
    reynolds_numbers: tuple[float, ...] = ()
    """Reynolds numbers of which an episode's seed draws one; that of the case when there are none."""
    history: int = 1
    """Observations that the agent sees at once, the oldest first; before there are as many, the first one again."""
    delay: int = 0
    """Actions that pass until an action takes effect; before the first does, nothing acts."""
    charge: Charge = twice_the_worst
    """What a flow that blew up is given for every action that was left, with which its episode ends."""

    def __post_init__(self) -> None:
        if self.actions < 2:
            raise ValueError(f"actions: got {self.actions}, wanted at least 2")
        if self.actions != int(self.actions):
            raise ValueError(f"actions: got {self.actions}, wanted a whole number")
        if self.starts not in STARTS:
            raise ValueError(f"starts: got {self.starts!r}, wanted one of {', '.join(STARTS)}")
        object.__setattr__(self, "reynolds_numbers", tuple(self.reynolds_numbers))
        for name, least in (("history", 1), ("delay", 0)):
            value = getattr(self, name)
            if value != int(value) or value < least:
                raise ValueError(f"{name}: got {value}, wanted a whole number, at least {least}")
        if not self.interval > 0:
            raise ValueError(f"interval: got {self.interval:g}, wanted a positive time")
        if isinstance(self.law, type) or not hasattr(self.law, "series"):
            raise ValueError(f"law: got {self.law!r}, wanted an object, as Held() or Linear()")

    def steps(self, time_step: float) -> int:
        """Return the solver steps of an action; ValueError when the interval is no multiple of the time step."""
        ratio = self.interval / time_step
        steps = round(ratio) if math.isfinite(ratio) else 0
        if steps < 1 or not math.isclose(ratio, steps, rel_tol=1e-9):
            raise ValueError(
                f"interval: got {self.interval:g}, wanted a multiple of the time step {time_step:g}; "
                f"the nearest is {max(steps, 1) * time_step:g}"
            )
        return steps


def drawn(task: Task, seed: int) -> int:
    """Return which of its Reynolds numbers an episode's seed draws."""
    return _draw(seed, 3, len(task.reynolds_numbers) or 1)


def begun(task: Task, seed: int, starts: int) -> int:
    """Return which of so many start states an episode of a seed begins from."""
    return 0 if task.starts == "first" else _draw(seed, 0, starts)


def _draw(seed: int, stream: int, among: int) -> int:
    """Return a number below `among` that a stream of a seed draws."""
    return int(np.random.SeedSequence(seed, spawn_key=(stream,)).generate_state(1)[0]) % among


def matrix(task: Task, inputs: int) -> np.ndarray:
    """Return the mixing (inputs, actions), scaled so that actions in [-1, 1] keep every input within its limit."""
    rows = np.eye(inputs) if task.mixing is None else np.array(task.mixing, dtype=float)
    if rows.ndim != 2 or len(rows) != inputs or not rows.any() or not np.isfinite(rows).all():
        raise ValueError(
            f"mixing: got a matrix of shape {rows.shape}, wanted {inputs} rows of finite numbers, one for each input, "
            "and a column for each action"
        )
    return rows / max(abs(rows).sum(axis=1).max(), 1.0)
