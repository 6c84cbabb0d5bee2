"""Sensors: what is observed, by name, as rows of numbers that multiply the velocity or the pressure."""

from dataclasses import dataclass, field
from typing import ClassVar, Literal

from manywake.case.geometry import Point


@dataclass(frozen=True)
class Sensor:
    """Reads a field at points. `field` says which; a velocity has two values a point, u0, v0, u1, v1, ..."""

    name: str
    points: tuple[Point, ...]
    noise: float = field(default=0.0, kw_only=True)
    """Root mean square of the error that is added to every value, in the sensor's unit."""
    field: ClassVar[Literal["pressure", "velocity"]]


class Pressure(Sensor):
    """Pressure at points, in units of rho U^2."""

    field = "pressure"


class Velocity(Sensor):
    """Velocity at points, both components of each."""

    field = "velocity"


def values(sensor: Sensor) -> int:
    """Return how many numbers a sensor gives."""
    return len(sensor.points) * (2 if sensor.field == "velocity" else 1)
