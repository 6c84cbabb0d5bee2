"""Sensors: what is observed, by name, as rows of numbers that multiply the velocity or the pressure."""

from dataclasses import dataclass
from typing import ClassVar, Literal, Protocol

from manywake.case.geometry import Point


class Sensor(Protocol):
    """Reads a field at points. `field` says which; a velocity has two values a point, u0, v0, u1, v1, ..."""

    @property
    def name(self) -> str: ...

    @property
    def points(self) -> tuple[Point, ...]: ...

    field: ClassVar[Literal["pressure", "velocity"]]


@dataclass(frozen=True)
class Pressure:
    """Pressure at points, in units of rho U^2."""

    name: str
    points: tuple[Point, ...]
    field: ClassVar[Literal["pressure", "velocity"]] = "pressure"


@dataclass(frozen=True)
class Velocity:
    """Velocity at points, both components of each."""

    name: str
    points: tuple[Point, ...]
    field: ClassVar[Literal["pressure", "velocity"]] = "velocity"


def values(sensor: Sensor) -> int:
    """Return how many numbers a sensor gives."""
    return len(sensor.points) * (2 if sensor.field == "velocity" else 1)
