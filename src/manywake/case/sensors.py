"""Sensors: what is observed, by name: fields at points, and integrals, which a reward sees too."""

from dataclasses import dataclass, field
from typing import ClassVar, Literal

from manywake.case.geometry import Point

RESERVED = ("c_d", "c_l", "c_m", "power", "work", "amplitudes", "unsteadiness")
"""Names that an integral cannot have, as other readings have them."""


@dataclass(frozen=True)
class Sensor:
    """What is observed under a name."""

    name: str
    noise: float = field(default=0.0, kw_only=True)
    """Root mean square of the error that is added to every value, in the sensor's unit."""
    unit: ClassVar[str]


@dataclass(frozen=True)
class Probes(Sensor):
    """Reads a field at points. `field` says which; a velocity has two values a point, u0, v0, u1, v1, ..."""

    points: tuple[Point, ...]
    field: ClassVar[Literal["pressure", "velocity"]]


class Pressure(Probes):
    """Pressure at points, divided by the density, in the case's unit of velocity squared."""

    field = "pressure"
    unit = "the case's unit of velocity squared"


class Velocity(Probes):
    """Velocity at points, both components of each."""

    field = "velocity"
    unit = "the case's unit of velocity"


@dataclass(frozen=True)
class Shear(Sensor):
    """The slope of the velocity along a wall with the distance from it, integrated over the wall, in units of U.

    Positive where the fluid moves forwards for one who walks along the wall with the fluid on the left: in x on a
    floor, against x on a ceiling, clockwise round a body.
    """

    on: str
    """A side of the domain, a body, or a part of one."""
    unit = "U"


@dataclass(frozen=True)
class Energy(Sensor):
    """What the flow departs from the steady one: 1/2 of the integral of |u - u_steady|^2, in the case's units."""

    unit = "the case's units of velocity times length, squared"


Integral = Shear | Energy
"""One number each, which is a reading as well: it has a mean over every action, and one without control."""


def values(sensor: Sensor) -> int:
    """Return how many numbers a sensor gives."""
    if not isinstance(sensor, Probes):
        return 1
    return len(sensor.points) * (2 if sensor.field == "velocity" else 1)


def integrals(sensors: tuple[Sensor, ...]) -> tuple[Integral, ...]:
    """Return the integrals among sensors."""
    return tuple(sensor for sensor in sensors if isinstance(sensor, Integral))
