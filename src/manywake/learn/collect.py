"""Collection of episodes for one update: blocks of columns out to the engine, episodes back in index order."""

from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, wait

from manywake.env.task import Task
from manywake.flow import simd
from manywake.flow.case import Case
from manywake.learn.engine import Engine
from manywake.learn.policy import Policy
from manywake.learn.rollout import Episode, rollout


class Collector:
    """Plays the episodes of a training run, synced: all of one update under one policy, all waited for."""

    def __init__(self, engine: Engine, case: Case, task: Task, run_seed: int, lanes: int = simd.WIDTHS[0]):
        self.engine = engine
        self.case, self.task, self.run_seed, self.lanes = case, task, run_seed, lanes

    def collect(self, policy: Policy, indices: range, arrived: Callable[[list[Episode]], None]) -> list[Episode]:
        """Return the episodes of `indices` in that order; `arrived` is called with each block as it comes."""
        blocks = [list(indices[k : k + self.lanes]) for k in range(0, len(indices), self.lanes)]
        waiting = {self.engine.submit(rollout, self.case, self.task, policy, self.run_seed, block) for block in blocks}
        episodes: list[Episode] = []
        while waiting:
            finished, waiting = wait(waiting, return_when=FIRST_COMPLETED)
            for future in finished:
                arrived(future.result())
                episodes += future.result()
        return sorted(episodes, key=lambda episode: episode.index)
