"""What holds on the sides of the domain; bodies are no-slip. Where two sides meet the later condition wins.

A given velocity comes before `FreeSlip`, and that before `Outflow`, whatever their order. All that give one have
velocity(side, x): the velocity (k, 2) at points (k, 2) of a side.
"""

from dataclasses import dataclass, fields

import numpy as np


@dataclass(frozen=True, init=False)
class _Named:
    """Takes the names of sides as positional arguments, settings by name."""

    on: tuple[str, ...]

    def __init__(self, *on: str, **settings: float):
        object.__setattr__(self, "on", on)
        for name, value in settings.items():
            if name not in {field.name for field in fields(self)}:
                raise TypeError(f"{type(self).__name__}() got an unexpected keyword argument {name!r}")
            object.__setattr__(self, name, value)


class NoSlip(_Named):
    """Walls at rest."""

    def velocity(self, side, x):
        return np.zeros_like(x)


@dataclass(frozen=True, init=False)
class Stream(_Named):
    """A uniform velocity: an inflow, a side that moves with the stream, or the moving wall of a cavity."""

    x: float = 1.0
    y: float = 0.0

    def velocity(self, side, x):
        return np.tile([self.x, self.y], (len(x), 1))


@dataclass(frozen=True, init=False)
class Parabola(_Named):
    """Developed channel flow inwards: of mean `mean`, its peak half as much again."""

    mean: float = 1.0

    def velocity(self, side, x):
        low, high = (np.array(end) for end in sorted((side.start, side.end)))
        length = float(np.linalg.norm(high - low))
        along = (high - low) / length
        profile = 6.0 * self.mean * ((x - low) @ along) * ((high - x) @ along) / length**2
        return profile[:, None] * side.chart(x).outward


class FreeSlip(_Named):
    """Nothing flows through and nothing rubs: a line of symmetry, or a wall far away. For sides along x or along y.

    At its ends it takes the velocity that is given on the next side, but for the component through the slip side.
    """


class Outflow(_Named):
    """An open end: p = 0, and no viscous traction but on what comes back in, (u . n) u / 2."""


Free = FreeSlip | Outflow
"""Where the velocity is found and not given."""
Condition = NoSlip | Stream | Parabola | Free
