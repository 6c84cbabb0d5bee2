"""What a page shows of a run under way: its learning curve so far, and its newest policy."""

from pathlib import Path
from typing import Any

import numpy as np

from manywake.learn import tables
from manywake.learn.policy import Policy
from manywake.learn.runs import Run

POINTS = 240
"""Of the curve, at most: a longer training is shown in means over neighbours."""


class Training:
    """A run folder that is looked at again and again. free: the uncontrolled mean of the drag, where there is one."""

    def __init__(self, run: Run, free: float | None):
        self.run, self.free = run, free
        self._table = run.folder / "episodes.csv"
        self._seen: tuple[int, int] | None = None
        self._version = -1
        self._curve: dict[str, Any] | None = None

    def policy(self) -> Policy | None:
        """Return the newest policy if it is newer than the last that was returned."""
        known = sorted((self.run.folder / "versions").glob("*.npz"))
        if not known or known[-1].stem == f"{self._version:06d}":
            return None
        newest = self.run.newest_version()
        self._version = int(known[-1].stem)
        return newest

    def told(self, curve: dict[str, Any] | None) -> dict[str, Any]:
        """Return what a page is told: the last curve that there was, and the number of the newest policy."""
        self._curve = curve or self._curve
        return {"run": self.run.folder.name, "version": self._version, "curve": self._curve, "problem": None}

    def curve(self) -> dict[str, Any] | None:
        """Return the learning curve if there is more of it than the last time.

        Drag saved in percent, over the second half of each episode, with the noise of exploration; the episode's reward
        where there is no drag.
        """
        now = _stamp(self._table)
        if now is None or now == self._seen:
            return None
        table = tables.columns(self._table)
        if not table:
            return None
        self._seen = now
        name, values = "reward of an episode", table["reward"]
        if self.free and "c_d_second_half" in table:
            name, values = "drag saved in training, %", 100 * (1 - table["c_d_second_half"] / self.free)
        order = np.argsort(table["episode"], kind="stable")
        episodes, values = table["episode"][order], values[order]
        parts = np.array_split(np.arange(len(episodes)), min(POINTS, len(episodes)))
        means = [(float(episodes[part[-1]] + 1), _mean(values[part])) for part in parts]
        return {
            "name": name,
            "done": len(episodes),
            "total": self.run.settings.learning.episodes,
            "points": [[x, round(y, 4)] for x, y in means if np.isfinite(y)],
            "minutes": round(float(table["wall_s"].max()) / 60, 1) if "wall_s" in table else None,
        }


def _mean(values: np.ndarray) -> float:
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if len(finite) else float("nan")


def _stamp(path: Path) -> tuple[int, int] | None:
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size
