"""References: numbers that are not ours, which `manywake validate` compares with, as data.

Tolerances are relative; None reports a number without judging it. A number without a Reynolds number of its own is of
the case as it is. Of several that need the same flow, that flow runs once.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from manywake.case.case import Case, readings
from manywake.case.geometry import Point, Side, distance

KINDS = ("mean", "max", "min", "rms", "amplitude")
"""What a reading can be asked for; its amplitude is half of max - min."""
SHEDS = 0.05
"""A flow sheds whose C_L has a larger amplitude than this..."""
SHEDDING = 40.0
"""...over the last of its run, in L / U."""
LIFTS = 0.02
"""A flow lifts whose mean C_L is further from zero than this, to whichever side."""
JUDGED = ("sheds", "lifts", "grows")
"""What is 1 or 0."""
STRAIGHT = 1e-9
"""Points this near to a side, as a share of its length, are on it."""


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
    tolerance: float | None
    source: str


@dataclass(frozen=True)
class Statistic(_Number):
    """A number of the uncontrolled flow, over whole periods if it has any: "St", or of a reading, as "c_d mean".

    Readings have a mean, max, min, rms and amplitude, which is half of max - min. "lifts", 1 or 0: whether the mean C_L
    of a flow is further from zero than 0.02, on average over flows, as where a flow breaks its symmetry. reynolds: of a
    flow that is spun up for this number, without actuators, on the case's mesh. time_step: of it, in the case's unit,
    the case's when not given.
    """

    reynolds: float | None = None
    time_step: float | None = None


@dataclass(frozen=True)
class Steady(_Number):
    """A reading of the steady flow, as "c_d", by Newton's method. reynolds: of that flow."""

    reynolds: float | None = None


@dataclass(frozen=True)
class Growth(_Number):
    """How a small disturbance of the steady flow grows: "rate", in U / L, or "grows", 1 or 0, the rate's sign.

    reynolds: of the flow. time_step: with which the disturbance is followed, in the case's unit, the case's when not
    given.
    """

    reynolds: float | None = None
    time_step: float | None = None


@dataclass(frozen=True)
class Extremum:
    """The largest or smallest velocity of the steady flow on a line, in units of U: of is "u max", "v min" and so on.

    The line runs through the fluid from `start` to `end`, which may be on walls. reynolds: of the flow.
    """

    name: str
    of: str
    start: Point
    end: Point
    value: float
    tolerance: float | None
    source: str
    reynolds: float | None = None


@dataclass(frozen=True)
class Length:
    """How far from `start`, in L, the steady flow separates or attaches again: where its wall shear changes sign.

    `start` and `end` lie on one straight side of the domain. change: which of the changes between them, 0 the first one
    from `start` on, -1 the last. reynolds: of the flow.
    """

    name: str
    start: Point
    end: Point
    change: int
    value: float
    tolerance: float | None
    source: str
    reynolds: float | None = None


@dataclass(frozen=True)
class Response(_Number):
    """A number of the flow from the start state with its actuators held: as of a `Statistic`, or "sheds", 1 or 0.

    amplitudes: one for each actuator; they may exceed its limit. They rise smoothly within settle / 60. duration:
    of the whole run, in L / U, of which `settle` is not averaged. "sheds": whether the amplitude of C_L over
    the last 40 L / U exceeds 0.05. time_step: of the run, in the case's unit, the case's when not given.
    """

    amplitudes: tuple[float, ...]
    settle: float
    duration: float
    time_step: float | None = None


@dataclass(frozen=True)
class Driven(_Number):
    """A number of a flow that starts at rest: "c_d max" and so on, or "pressure drop" between two points at its end.

    driving: the time, in the case's unit, -> an amplitude for each input. duration: in the case's unit of time. points:
    where the pressure is taken, the first one less the second, in units of rho U^2. time_step: as of a `Response`.
    """

    driving: Callable[[float], Sequence[float]]
    duration: float
    points: tuple[Point, Point] | None = None
    time_step: float | None = None


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


@dataclass(frozen=True)
class Twin:
    """The uncontrolled flow against a twin on a mesh twice as fine at half the time step, that hears the same noise.

    of: numbers as of a `Statistic`, "energy mean". tolerance: of each as a share; a mean may be off by half the width
    of the twin's 95 % confidence interval too. duration: of the runs from all start states, in the case's unit of time,
    of which `settle` is not averaged.
    """

    of: tuple[str, ...]
    tolerance: float
    duration: float
    settle: float


Number = Statistic | Steady | Growth | Extremum | Length | Response | Driven
"""References that are one number each."""
Reference = Number | Settled | Forced | Twin


def wall(case: Case, length: Length) -> Side:
    """Return the side of the domain that a length is measured on; ValueError when it is on none."""
    ends = np.array([length.start, length.end], dtype=float)
    for side in case.domain.sides():
        corners = np.array([side.start, side.end], dtype=float)
        if distance(corners, ends).max() <= STRAIGHT * np.linalg.norm(corners[1] - corners[0]):
            return side
    raise ValueError(
        f"reference {length.name!r}: got a length from {length.start} to {length.end}, wanted two points on one side "
        "of the domain"
    )


def check(case: Case, references: Sequence[Reference]) -> None:
    """Raise ValueError where a reference asks for what a case does not have."""
    if sum(isinstance(reference, Forced | Twin) for reference in references) > 1:
        raise ValueError("references: got two of Forced and Twin, wanted one, as a case keeps one fine reference")
    for reference in references:
        if isinstance(reference, Twin):
            _check_twin(case, reference)
        if isinstance(reference, Length):
            wall(case, reference)
        elif isinstance(reference, _Number | Extremum):
            _one_of(reference, _words(case, reference))
        if isinstance(reference, Response):
            if len(reference.amplitudes) != len(case.actuators):
                got, wanted = len(reference.amplitudes), len(case.actuators)
                raise ValueError(f"reference {reference.name!r}: got {got} amplitudes, wanted {wanted}")
            least = reference.settle + (SHEDDING if reference.of == "sheds" else 0.0)
            if not 0 < reference.settle < reference.duration or reference.duration < least:
                raise ValueError(
                    f"reference {reference.name!r}: got settle {reference.settle:g} of the duration "
                    f"{reference.duration:g}, wanted it positive, and a duration above {least:g}, settle and what is "
                    "judged"
                )
        if isinstance(reference, Driven) and (reference.of == "pressure drop") != (reference.points is not None):
            raise ValueError(
                f"reference {reference.name!r}: got points {reference.points} with {reference.of!r}, wanted two points "
                "with 'pressure drop', and with that alone"
            )


def _check_twin(case: Case, reference: Twin) -> None:
    words = [f"{name} {kind}" for name in readings(case) for kind in KINDS]
    for of in reference.of:
        if of not in words:
            raise ValueError(f"reference Twin: got {of!r}, wanted some of {', '.join(words)}")
    if not 0 < reference.settle < reference.duration:
        raise ValueError(
            f"reference Twin: got settle {reference.settle:g} of the duration {reference.duration:g}, wanted it "
            "positive and shorter"
        )


def _words(case: Case, reference: _Number | Extremum) -> list[str]:
    """Return what a reference can be of."""
    if isinstance(reference, Extremum):
        return [f"{component} {kind}" for component in "uv" for kind in ("max", "min")]
    names = readings(case)
    if isinstance(reference, Growth):
        return ["rate", "grows"]
    if isinstance(reference, Steady):
        return [name for name in names if name != "power"]
    numbers = [f"{name} {kind}" for name in names for kind in KINDS]
    if isinstance(reference, Driven):
        return [*numbers, "pressure drop"]
    bodies = ["St", "sheds" if isinstance(reference, Response) else "lifts"] if case.bodies else []
    return [*numbers, *bodies]


def _one_of(reference: _Number | Extremum, words: list[str]) -> None:
    if reference.of not in words:
        raise ValueError(f"reference {reference.name!r}: got {reference.of!r}, wanted one of {', '.join(words)}")
