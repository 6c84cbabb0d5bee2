"""Statistics of an uncontrolled flow: steady, periodic or neither, and means with what they are uncertain by."""

from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from scipy.special import stdtrit

Kind = Literal["steady", "periodic", "aperiodic"]

STEADY = 1e-4
"""A flow whose forces move by less than this, over a block of its record, is steady."""
REGULAR = 0.02
"""Periods of one length and amplitude differ by less than this, as shares."""
SEGMENTS = 5
"""Parts of an aperiodic record, of each flow, whose means are taken as independent."""


@dataclass(frozen=True)
class Moments:
    """Statistics of one reading. error: half the width of the 95 % confidence interval of its mean. rms: about zero."""

    mean: float
    error: float
    low: float
    high: float
    rms: float


@dataclass(frozen=True)
class Statistics:
    """What is known of an uncontrolled flow. `kind` says over what its means are.

    steady: over the last of the record. periodic: over whole periods. aperiodic: over all of the record, of several
    flows. period: of the lift, in units of time, None unless the flow is periodic. duration: averaged over, in units of
    time. readings: statistics of each reading by name.
    """

    kind: Kind
    period: float | None
    duration: float
    readings: dict[str, Moments]

    def __getitem__(self, reading: str) -> Moments:
        return self.readings[reading]

    @property
    def means(self) -> dict[str, float]:
        return {name: moments.mean for name, moments in self.readings.items()}

    def plain(self) -> dict[str, Any]:
        """Return it as JSON can hold it; `restored` is the way back."""
        return asdict(self)


def restored(plain: dict[str, Any]) -> Statistics:
    """Return the statistics that `Statistics.plain` described."""
    return Statistics(**plain | {"readings": {name: Moments(**part) for name, part in plain["readings"].items()}})


def crossings(signal: np.ndarray) -> np.ndarray:
    """Return the times, in steps, at which a signal (steps,) crosses the middle between its extremes upwards."""
    level = 0.5 * (signal.max() + signal.min())
    up = np.flatnonzero((signal[:-1] < level) & (signal[1:] >= level))
    return up + (level - signal[up]) / (signal[up + 1] - signal[up])


def period(signal: np.ndarray, time_step: float) -> float:
    """Return the mean period of a signal (steps,), in units of time; ValueError when it has fewer than two."""
    up = crossings(signal)
    if len(up) < 3:
        raise ValueError(f"shedding: got {len(up)} crossings of the lift, wanted at least 3; record for longer")
    return float((up[-1] - up[0]) / (len(up) - 1) * time_step)


def kind(record: dict[str, np.ndarray], clock: str) -> Kind:
    """Return of which kind a record is: readings by name, each (steps,). clock: the reading that tells the periods."""
    signal = record[clock]
    if all(np.ptp(series) < STEADY * max(1.0, abs(series).max()) for series in record.values()):
        return "steady"
    up = crossings(signal)
    if len(up) < 4:
        return "aperiodic"
    periods, parts = np.diff(up), np.split(signal, np.floor(up).astype(int) + 1)[1:-1]
    swings, middles = np.array([np.ptp(part) for part in parts]), np.array([part.mean() for part in parts])
    alike = np.ptp(periods) < REGULAR * periods.mean() and np.ptp(swings) < REGULAR * swings.mean()
    return "periodic" if alike and np.ptp(middles) < REGULAR * swings.mean() else "aperiodic"


def uncontrolled(record: dict[str, np.ndarray], clock: str, time_step: float, found: Kind) -> Statistics:
    """Return the statistics of readings by name, (steps, B) each, of B flows that are all of one kind.

    Those of periodic flows are over whole periods, whose length is the first one's; ValueError when there are fewer
    than two.
    """
    steps, flows = np.arange(len(record[clock])), range(record[clock].shape[1])
    length = period(record[clock][:, 0], time_step) if found == "periodic" else None
    if length:
        ends = [np.floor(crossings(record[clock][:, b])).astype(int) + 1 for b in flows]
        parts = [np.split(steps, mine)[1:-1] for mine in ends]
    else:
        parts = [np.array_split(steps, 1 if found == "steady" else SEGMENTS) for _ in flows]
    moments = {name: _moments([s[part, b] for b in flows for part in parts[b]]) for name, s in record.items()}
    return Statistics(found, length, time_step * sum(len(part) for mine in parts for part in mine), moments)


def half_width(values: np.ndarray) -> float:
    """Return half the width of the 95 % confidence interval of the mean of independent values (n,), n at least 2."""
    return float(stdtrit(len(values) - 1, 0.975) * values.std(ddof=1) / np.sqrt(len(values)))


def _moments(segments: list[np.ndarray]) -> Moments:
    """Return the moments of a series that comes in segments, its error from their means."""
    series, error = np.concatenate(segments), 0.0
    if len(segments) > 1:
        means = np.array([part.mean() for part in segments])
        error = half_width(means)
    found = series.mean(), error, series.min(), series.max(), np.sqrt(np.mean(series**2))
    return Moments(*(float(number) for number in found))
