"""Laws: how the amplitudes follow what the agent wants, from one time step to the next."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np


class Law(Protocol):
    """Turns what is wanted into amplitudes at every time step."""

    def series(
        self, steps: int, time_step: float, amplitude: np.ndarray, previous: np.ndarray, wanted: np.ndarray
    ) -> np.ndarray:
        """Return the amplitudes (steps, inputs, B) of one action.

        amplitude: (inputs, B) at its beginning. previous, wanted: (inputs, B), those that the last action and this one
        ask for.
        """


@dataclass(frozen=True)
class Exponential:
    """c += alpha (a - c) once in every `per` of time, and the same law in continuous time for any step."""

    alpha: float
    """Share of the way that is gone in `per`, in (0, 1]."""
    per: float
    """Time that alpha is quoted for, in the case's unit of time."""

    def __post_init__(self) -> None:
        if not 0 < self.alpha <= 1:
            raise ValueError(f"alpha: got {self.alpha:g}, wanted a value in (0, 1]")
        if not self.per > 0:
            raise ValueError(f"per: got {self.per:g}, wanted a positive time")

    def series(self, steps, time_step, amplitude, previous, wanted):
        ratio = time_step / self.per
        # twelve digits: the same on every libm, and exactly alpha at a step of `per`
        alpha = round(1.0 - (1.0 - self.alpha) ** ratio, 12)
        series = np.empty((steps, *wanted.shape))
        for s in range(steps):
            amplitude = amplitude + alpha * (wanted - amplitude)
            series[s] = amplitude
        return series


@dataclass(frozen=True)
class Linear:
    """A ramp from what the previous action wanted to what this one wants, reached at the last step."""

    def series(self, steps, time_step, amplitude, previous, wanted):
        share = (np.arange(steps) + 1.0)[:, None, None] / steps
        return (1.0 - share) * previous + share * wanted


@dataclass(frozen=True)
class Held:
    """No smoothing: what is wanted, from the first step on."""

    def series(self, steps, time_step, amplitude, previous, wanted):
        return np.repeat(wanted[None], steps, axis=0)
