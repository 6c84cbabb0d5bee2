"""What holds on the boundaries. Each condition begins with the names of its boundaries; at corners the later one wins.

A body is no-slip unless a condition names it. On a boundary of given velocity that is `velocity(side, x)`; `Outflow`
has none.
"""

from dataclasses import dataclass, fields
from typing import Protocol

import numpy as np

from manywake.case.geometry import Side


class Condition(Protocol):
    """Velocity given on some boundaries."""

    @property
    def on(self) -> tuple[str, ...]:
        """The names of the boundaries."""

    def velocity(self, side: Side | None, x: np.ndarray) -> np.ndarray:
        """Return the velocity (k, 2) at points (k, 2) of a side of the domain, or of a body (None)."""


class _Named:
    """Takes the names of boundaries as positional arguments, settings by name."""

    on: tuple[str, ...]

    def __init__(self, *on: str, **settings: float):
        object.__setattr__(self, "on", on)
        for name, value in settings.items():
            if name not in {field.name for field in fields(self)}:  # type: ignore[arg-type]
                raise TypeError(f"{type(self).__name__}() got an unexpected keyword argument {name!r}")
            object.__setattr__(self, name, value)


@dataclass(frozen=True, init=False)
class NoSlip(_Named):
    """Walls at rest."""

    on: tuple[str, ...]

    def velocity(self, side: Side | None, x: np.ndarray) -> np.ndarray:
        return np.zeros_like(x)


@dataclass(frozen=True, init=False)
class Stream(_Named):
    """A uniform velocity: an inflow, a side that moves with the stream, or the moving wall of a cavity."""

    on: tuple[str, ...]
    x: float = 1.0
    y: float = 0.0

    def velocity(self, side: Side | None, x: np.ndarray) -> np.ndarray:
        return np.tile([self.x, self.y], (len(x), 1))


@dataclass(frozen=True, init=False)
class Parabola(_Named):
    """Developed channel flow through a straight side, inwards: of mean `mean`, its peak half as much again."""

    on: tuple[str, ...]
    mean: float = 1.0

    def velocity(self, side: Side | None, x: np.ndarray) -> np.ndarray:
        if side is None:
            raise ValueError(f"Parabola: got {', '.join(self.on)}, wanted straight sides of the domain")
        low, high = (np.array(end) for end in sorted((side.start, side.end)))
        length = float(np.linalg.norm(high - low))
        along = (high - low) / length
        profile = 6.0 * self.mean * ((x - low) @ along) * ((high - x) @ along) / length**2
        return profile[:, None] * side.chart(x).outward


@dataclass(frozen=True, init=False)
class Outflow(_Named):
    """An open end: p = 0 and no viscous traction."""

    on: tuple[str, ...]
