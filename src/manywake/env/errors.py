"""Errors of sensors: noise that is added to what they read, drawn from the seed of each flow's episode.

An error is the sum of twelve uniform numbers less its mean: nearly normal, at most six times its rms. No logarithm is
in it, so it has the same bits everywhere.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from manywake.case.case import Case

_STREAM = 2
"""First word of the spawn key of a sensor's errors, its number being the second: one seed feeds other streams too."""
_SUMMED = 12


class Errors:
    """The errors of the sensors of B flows, of each sensor of each flow from a stream of its own."""

    def __init__(self, case: Case, flows: int):
        self._rms = {sensor.name: sensor.noise for sensor in case.sensors if sensor.noise > 0}
        self._streams: list[dict[str, np.random.Generator]] = [{} for _ in range(flows)]

    def reset(self, column: int, seed: int) -> None:
        """Begin the errors of a flow anew."""
        for k, name in enumerate(self._rms):
            sequence = np.random.SeedSequence(seed, spawn_key=(_STREAM, k))
            self._streams[column][name] = np.random.Generator(np.random.PCG64(sequence))

    def added(self, sensor: str, read: np.ndarray, columns: Sequence[int] | np.ndarray) -> np.ndarray:
        """Return what a sensor reads of some flows, (columns, values), with the next error of each."""
        if sensor not in self._rms:
            return read
        drawn = np.stack([self._streams[column][sensor].random((_SUMMED, read.shape[1])) for column in columns])
        error = np.zeros_like(read)
        for k in range(_SUMMED):  # summed in order, so that no bit depends on the shape
            error = error + drawn[:, k]
        return read + self._rms[sensor] * (error - _SUMMED / 2)

    def state(self, column: int) -> list[dict[str, Any]]:
        """Return where the streams of a flow are."""
        return [dict(stream.bit_generator.state) for stream in self._streams[column].values()]

    def resume(self, column: int, states: list[dict[str, Any]]) -> None:
        """Go on from where streams were."""
        for name, state in zip(self._rms, states, strict=True):
            self._streams[column][name] = np.random.Generator(np.random.PCG64())
            self._streams[column][name].bit_generator.state = state
