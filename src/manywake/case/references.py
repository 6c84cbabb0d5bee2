"""References: numbers that are not ours, which `manywake validate` compares with. Tolerances are relative."""

from collections.abc import Mapping
from dataclasses import dataclass

from manywake.case.geometry import Point


@dataclass(frozen=True)
class Settled:
    """Readings of the flow that the start state decays to at another Reynolds number, by time stepping.

    values: reading -> (reference, tolerance). pressure_drop: two points, and what the difference is multiplied with to
    be in the reference's units, (reference, tolerance) as well.
    """

    name: str
    reynolds: float
    values: Mapping[str, tuple[float, float]]
    source: str
    pressure_drop: tuple[Point, Point, float, tuple[float, float]] | None = None


@dataclass(frozen=True)
class _Number:
    name: str
    of: str
    value: float
    tolerance: float
    source: str


class Statistic(_Number):
    """A number of the uncontrolled flow over whole periods: a reading's mean, max, min or rms, as "c_d max", or St."""


class Steady(_Number):
    """A reading of the steady flow at the case's Reynolds number, by Newton's method."""


@dataclass(frozen=True)
class Forced:
    """Changes of mean drag and of lift by the first action against a mesh twice as fine at half the time step.

    steady: amplitudes of the first input that are held; the change of lift is that of its mean. harmonic: (amplitude,
    frequency, phases); the change of lift is that of its rms, drag and lift are means over flows whose forcing is 1 /
    phases of a cycle apart. floor: deviation that is tolerated of any change, however small that is. duration: of the
    runs from the start state, of which `settle` is not averaged.
    """

    steady: tuple[float, ...]
    harmonic: tuple[tuple[float, float, int], ...]
    tolerance: float
    duration: float
    settle: float
    floor: float = 0.0


Reference = Settled | Statistic | Steady | Forced
