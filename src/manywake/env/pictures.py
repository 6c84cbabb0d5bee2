"""What environments show: a picture of each flow, or a window that follows their steps."""

import math
from collections.abc import Sequence

import numpy as np

from manywake.env.scene import Scene
from manywake.env.several import SeveralFlows
from manywake.env.window import Window

MODES = ("rgb_array", "human")
SPEED = 25
"""Pictures a second of a film."""


class Pictures:
    """Pictures of the flows of a batch. mode: one of `MODES`, or None, then nothing is kept."""

    def __init__(self, flows: SeveralFlows, mode: str | None):
        if mode not in (None, *MODES):
            raise ValueError(f"render_mode: got {mode!r}, wanted None or one of {', '.join(MODES)}")
        self._flows, self._mode = flows, mode
        self._scenes: dict[int, Scene] = {}
        self._traces: list[list[tuple[float, ...]]] = [[] for _ in range(flows.count)]
        self._window: Window | None = None

    def restart(self, column: int) -> None:
        """Forget the traces of a flow whose episode begins."""
        self._traces[column] = []

    def follow(self, fresh: np.ndarray) -> None:
        """Keep what the last action brought, for the traces, but of fresh flows, (B,); show it if there is a window."""
        if self._mode is None:
            return
        flows = self._flows
        means, names = flows.means, flows.flows[0].baseline.shown
        for b in np.flatnonzero(~fresh):
            time = float(flows.actions[b] * flows.task.interval)
            self._traces[b].append((time, *(float(means[name][b]) for name in names)))
        if self._mode == "human":
            self.render()

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Return a picture of each flow; with the mode human show them side by side and return None."""
        if self._mode is None:
            raise ValueError("render: got no render_mode, wanted render_mode='rgb_array' or 'human' when it is made")
        pictures = tuple(self._picture(column) for column in range(self._flows.count))
        if self._mode == "rgb_array":
            return pictures
        self._window = self._window or Window("manywake")
        self._window.show(_tiled(pictures))
        return None

    def close(self) -> None:
        if self._window is not None:
            self._window.close()

    def _picture(self, column: int) -> np.ndarray:
        which, (flow, state), task = self._flows.which(column), self._flows.state(column), self._flows.task
        if which not in self._scenes:
            self._scenes[which] = Scene(flow, task.actions * task.interval)
        limits = np.array([actuator.limit for actuator in flow.case.actuators])
        return self._scenes[which].frame(state, self._flows.amplitude[column] / limits, self._traces[column])


def _tiled(pictures: Sequence[np.ndarray]) -> np.ndarray:
    """Return pictures of one size side by side, in a block that is about as wide as it is high."""
    high = math.ceil(math.sqrt(len(pictures)))
    blank = np.full_like(pictures[0], 255)
    rows = [[*pictures[k::high]] for k in range(high)]
    wide = max(map(len, rows))
    return np.concatenate([np.concatenate(row + [blank] * (wide - len(row)), axis=1) for row in rows])
