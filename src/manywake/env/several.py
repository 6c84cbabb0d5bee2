"""Flows of several Reynolds numbers side by side, each of which an episode's seed draws (`Task.reynolds_numbers`)."""

from collections.abc import Sequence

import numpy as np

from manywake.case import task as tasks
from manywake.case.task import Task
from manywake.env.control import ControlledFlows, Snapshot
from manywake.flow.batch import Start
from manywake.flow.store import Flow


class SeveralFlows:
    """B flows under one task, of which those of one Reynolds number advance together.

    flows: one for each of the task's Reynolds numbers, or the only one.
    """

    def __init__(self, flows: Sequence[Flow], task: Task, count: int):
        self.flows, self.task, self.count = flows, task, count
        self._which = np.full(count, -1)
        self._parts: dict[int, ControlledFlows] = {}
        self.reset(range(count), range(count))

    def reset(self, columns: Sequence[int] | np.ndarray, seeds: Sequence[int]) -> None:
        """Begin an episode of a seed in each of some columns, at the Reynolds number that the seed draws."""
        which = self._which.copy()
        which[list(columns)] = [tasks.drawn(self.task, seed) for seed in seeds]
        if (which != self._which).any():
            self._move(which)
        seed_of = dict(zip(map(int, columns), seeds, strict=True))
        for k, part in self._parts.items():
            mine = [(c, seed_of[b]) for c, b in enumerate(self._members(k).tolist()) if b in seed_of]
            if mine:
                part.reset([column for column, _ in mine], [seed for _, seed in mine])

    def _move(self, which: np.ndarray) -> None:
        """Let the flows of each Reynolds number stand together again; those that stay at theirs go on as they were."""
        kept = {b: self.snapshot(b) for b in np.flatnonzero((which == self._which) & (which >= 0)).tolist()}
        self._which, self._parts = which, {}
        for k in np.unique(which).tolist():
            members = self._members(k).tolist()
            self._parts[k] = ControlledFlows(self.flows[k], self.task, len(members))
            for column, b in enumerate(members):
                if b in kept:
                    self._parts[k].restore(column, kept[b])

    def _members(self, k: int) -> np.ndarray:
        """Return the columns of all flows of one Reynolds number, in their order."""
        return np.flatnonzero(self._which == k)

    def _at(self, column: int) -> tuple[ControlledFlows, int]:
        """Return which flows a column's advances with, and its place among them."""
        k = self.which(column)
        return self._parts[k], int(np.searchsorted(self._members(k), column))

    def snapshot(self, column: int) -> Snapshot:
        """Return all that one flow's future depends on, but for its Reynolds number."""
        part, place = self._at(column)
        return part.snapshot(place)

    def state(self, column: int) -> tuple[Flow, Start]:
        """Return one flow's case and baseline, and where it is now."""
        part, place = self._at(column)
        return part.flow, part.batch.state(place)

    def restore(self, column: int, which: int, kept: Snapshot) -> None:
        """Put a flow to a Reynolds number, by its place in the task's, and back to where a snapshot was taken."""
        if which != self._which[column]:
            moved = self._which.copy()
            moved[column] = which
            self._move(moved)
        part, place = self._at(column)
        part.restore(place, kept)

    def which(self, column: int) -> int:
        """Return the place of a flow's Reynolds number in the task's."""
        return int(self._which[column])

    def reynolds(self) -> np.ndarray:
        """Return the Reynolds number of each flow, (B,)."""
        return np.array([self.flows[k].case.reynolds for k in self._which])

    def act(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Act on all flows, as `ControlledFlows.act`; return rewards, which blew up, which are at their horizon."""
        reward, (diverged, truncated) = np.zeros(self.count), np.zeros((2, self.count), dtype=bool)
        for k, part in self._parts.items():
            mine = self._members(k)
            outcome = part.act(actions[mine])
            reward[mine], diverged[mine], truncated[mine] = outcome.reward, outcome.diverged, outcome.truncated
        return reward, diverged, truncated

    def observe(self) -> np.ndarray:
        """Return what the task observes, (B, values)."""
        return self._gathered([part.observe() for part in self._parts.values()])

    @property
    def amplitude(self) -> np.ndarray:
        """What each of the agent's inputs does now, (B, inputs)."""
        return self._gathered([part.amplitude.T for part in self._parts.values()])

    @property
    def actions(self) -> np.ndarray:
        """How many actions each episode has had, (B,)."""
        return self._gathered([part.actions for part in self._parts.values()])

    @property
    def means(self) -> dict[str, np.ndarray]:
        """Readings of the last action by name, (B,)."""
        parts = [part.means for part in self._parts.values()]
        return {name: self._gathered([part[name] for part in parts]) for name in parts[0]}

    def _gathered(self, parts: list[np.ndarray]) -> np.ndarray:
        """Return what is known of each part's flows in the order of all."""
        out = np.empty((self.count, *parts[0].shape[1:]), parts[0].dtype)
        for k, part in zip(self._parts, parts, strict=True):
            out[self._members(k)] = part
        return out
