"""Chance: what disturbances drive a batch of flows by, drawn from the seed of each flow's episode.

An amplitude follows n <- r n + sqrt(1 - r^2) sqrt(3) rms U(-1, 1) at every step, with r = exp(-dt / time) (eq. 20).
Uniform numbers need no logarithm, so the series has the same bits everywhere.
"""

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from manywake.flow.operators import Operators

WARM_UP = 8.0
"""Correlation times that a series has gone through when its episode begins: its variance is then off by 1e-7."""
_KEY = 1
"""First word of a disturbance's spawn key, its number being the second: one seed feeds other streams too."""


class Disturbances:
    """The series of all disturbances of B flows, each from a stream of its own."""

    def __init__(self, ops: Operators, seeds: Iterable[int]):
        seeds, (rms, time, self._limit) = list(seeds), ops.noise.T[:, :, None]
        # twelve digits: the same on every libm
        self._keep = np.array([[round(math.exp(-ops.time_step / each), 12)] for each in time[:, 0]]).reshape(-1, 1)
        self._size = np.sqrt(3.0 * (1.0 - self._keep**2)) * rms
        self._warm_up = [math.ceil(WARM_UP * each / ops.time_step) for each in time[:, 0]]
        self._now = np.zeros((len(rms), len(seeds)))
        self._streams: list[dict[int, np.random.Generator]] = [{} for _ in rms]
        self.reset(range(len(seeds)), seeds)

    def reset(self, columns: Iterable[int], seeds: Iterable[int]) -> None:
        """Begin the series of some columns anew, each from its seed, as if they had gone on for long."""
        columns, seeds = list(columns), list(seeds)
        for k, steps in enumerate(self._warm_up):
            drawn = np.empty((steps, len(columns)))
            for b, (column, seed) in enumerate(zip(columns, seeds, strict=True)):
                sequence = np.random.SeedSequence(seed, spawn_key=(_KEY, k))
                self._streams[k][column] = np.random.Generator(np.random.PCG64(sequence))
                drawn[:, b] = self._streams[k][column].random(steps)
            self._now[k, columns] = _filtered(drawn, np.zeros(len(columns)), self._keep[k], self._size[k])[-1]

    def series(self, steps: int) -> np.ndarray:
        """Return the amplitudes of the next steps, (steps, disturbances, B)."""
        drawn = np.empty((steps, *self._now.shape))
        for k, column in np.ndindex(*self._now.shape):
            drawn[:, k, column] = self._streams[k][column].random(steps)
        series = _filtered(drawn, self._now, self._keep, self._size)
        self._now = series[-1] if steps else self._now
        return np.clip(series, -self._limit, self._limit)

    def state(self, column: int) -> list[tuple[float, dict[str, Any]]]:
        """Return where the series of a column are: the last amplitude of each, and its stream."""
        last = self._now[:, column].tolist()
        return [(now, dict(s[column].bit_generator.state)) for now, s in zip(last, self._streams, strict=True)]

    def resume(self, column: int, states: list[tuple[float, dict[str, Any]]]) -> None:
        """Go on from where the series of a column were."""
        for k, (now, state) in enumerate(states):
            self._now[k, column] = now
            self._streams[k][column] = np.random.Generator(np.random.PCG64())
            self._streams[k][column].bit_generator.state = state


def _filtered(drawn: np.ndarray, now: np.ndarray, keep: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Return what uniform numbers in [0, 1), (steps, ...), make of a series whose last values are `now`."""
    series = np.empty_like(drawn)
    for s in range(len(drawn)):
        series[s] = now = keep * now + size * (2.0 * drawn[s] - 1.0)
    return series
