"""A picture of a training under way, kept up to date beside it: it reads what the training wrote, and changes nothing.

It is drawn in a thread of its own, as the next block of episodes waits for whoever is told of the last one.
"""

import threading
import time
from pathlib import Path

import numpy as np

from manywake.learn import tables
from manywake.learn.evaluate import titled
from manywake.learn.rollout import Episode
from manywake.learn.rows import Shares

EVERY = 5.0
"""Least seconds from one picture to the next."""
SHARE = 0.02
"""Most of the time that is spent on pictures."""
NAME = "watch.png"


class Watch:
    """Keeps `NAME` in a run's folder; `show` is a `train.Show`. total: episodes of the training.

    problem: what a picture failed by, after which there are no more; the training goes on.
    """

    def __init__(self, folder: Path, total: int):
        from manywake import plots

        self.folder, self.total = folder, total
        self.problem: Exception | None = None
        self._plots = plots
        self._newest: Episode | None = None
        self._fresh = self._closed = False
        self._change = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="watch", daemon=True)
        self._thread.start()

    def __enter__(self) -> "Watch":
        return self

    def __exit__(self, *error: object) -> None:
        """Draw what came last, and end."""
        with self._change:
            self._closed, self._fresh = True, self._newest is not None
            self._change.notify_all()
        self._thread.join()

    def show(self, episodes: list[Episode], shares: Shares, failures: int) -> None:
        """Take a block of episodes."""
        with self._change:
            for episode in episodes:
                self._newest = self._newest if episode.terminated else episode
            self._fresh = self._newest is not None
            self._change.notify_all()

    def _run(self) -> None:
        while True:
            with self._change:
                self._change.wait_for(lambda: self._fresh or self._closed)
                newest, fresh, self._fresh = self._newest, self._fresh, False
            if not fresh or newest is None:
                return
            begun = time.perf_counter()
            try:
                self._draw(newest)
            except Exception as problem:  # a full disk, say: the training is worth more than its picture
                self.problem = problem
                return
            seconds = time.perf_counter() - begun
            with self._change:
                self._change.wait_for(lambda: self._closed, max(EVERY, seconds / SHARE))

    def _draw(self, newest: Episode) -> None:
        table = tables.columns(self.folder / "episodes.csv")
        both: dict[str, np.ndarray] = {n: newest.readings[n] for n in ("c_d", "c_l") if n in newest.readings}
        done = f"{len(table['episode']) if table else 0} of {self.total} episodes"
        passed = f" in {table['wall_s'].max() / 60:.1f} min" if table else ""
        series = both if len(both) == 2 else {"reward": newest.rewards}
        self._plots.watch(table, series, f"{titled(self.folder)}: {done}{passed}", self.folder / NAME)
