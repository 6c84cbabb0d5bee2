"""Statistics of a force signal over whole periods of shedding."""

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Shedding:
    """Statistics of C_D and C_L over whole shedding periods; C = 2F / (rho U^2 L)."""

    cd_mean: float
    cd_max: float
    cd_min: float
    cl_mean: float
    cl_max: float
    cl_min: float
    cl_rms: float
    period: float
    periods: int

    def strouhal(self, convective_time: float) -> float:
        """St = L / (U T), of the time L / U."""
        return convective_time / self.period


def _crossings(c_l: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the steps after which C_L crosses the middle between its extremes upwards, and that middle."""
    level = 0.5 * (c_l.max() + c_l.min())
    above = c_l >= level
    up = np.flatnonzero(~above[:-1] & above[1:])
    if len(up) < 3:
        raise ValueError(f"shedding: got {max(len(up) - 1, 0)} whole periods, wanted at least 2; record for longer")
    return up, level


def whole_periods(c_l: np.ndarray) -> slice:
    """Return the steps between the first and the last upward crossing of C_L's mid-range; ValueError as `shedding`."""
    up, _ = _crossings(c_l)
    return slice(int(up[0]) + 1, int(up[-1]) + 1)


def shedding(c_d: np.ndarray, c_l: np.ndarray, time_step: float, clock: np.ndarray | None = None) -> Shedding:
    """Return the statistics of a signal (steps,) over its `whole_periods`; cl_rms is about zero.

    clock: another signal whose crossings count. Raises ValueError when there are fewer than two whole periods.
    """
    clock = c_l if clock is None else clock
    up, level = _crossings(clock)
    crossing = up + (level - clock[up]) / (clock[up + 1] - clock[up])
    whole = whole_periods(clock)
    d, lift = c_d[whole], c_l[whole]
    period = (crossing[-1] - crossing[0]) / (len(up) - 1) * time_step
    found = d.mean(), d.max(), d.min(), lift.mean(), lift.max(), lift.min(), np.sqrt(np.mean(lift**2)), period
    numbers: list[Any] = [*(float(number) for number in found), len(up) - 1]
    return Shedding(*numbers)
