"""A case: one flow as data. Geometry, conditions, inputs, sensors, scales, sizes and scheme."""

import math
from dataclasses import dataclass
from typing import Any

from manywake.case import checks
from manywake.case.conditions import Condition, Outflow
from manywake.case.geometry import Body, Domain, Msh
from manywake.case.inputs import Input, Noise
from manywake.case.schemes import BDF2_MEAN, Scheme
from manywake.case.sensors import Sensor, integrals

RESOLVED = 100.0
"""The Reynolds number that the default sizes and the schemes' time steps are for."""
STEEP = 0.85
"""The parts that a scheme's step is cut into grow as this power of the Reynolds number."""
LENIENT = 0.2
"""By how much those parts may fall short of that rule."""


@dataclass(frozen=True)
class Scales:
    """What the Reynolds number and all coefficients are made with: Re = U L / nu, C = 2F / (rho U^2 L), rho = 1."""

    length: float = 1.0
    """L, the diameter of a cylinder, say."""
    velocity: float = 1.0
    """U, the mean inflow velocity, say."""


@dataclass(frozen=True, init=False)
class Near:
    """Sides of the domain near which triangles are smaller: Near("lid", "left", size=0.01, growth=0.1)."""

    on: tuple[str, ...]
    """Names of sides."""
    size: float
    """Length of the triangles' sides there, in L."""
    growth: float
    """By how much they are longer for every length away from there."""

    def __init__(self, *on: str, size: float, growth: float):
        for name, value in {"on": on, "size": size, "growth": growth}.items():
            object.__setattr__(self, name, value)


@dataclass(frozen=True)
class Sizes:
    """Sizes of the triangles, in units of the case's length. The defaults resolve the wake of a cylinder at Re 100."""

    body: float = 0.052
    """Length of the facets of a body, in L; beside a part they are as long as the part's and grow to this."""
    part_facets: int = 5
    """Facets across a part of a body; two resolve a jet's flux to 0.22 % before scaling, one to 4 %."""
    layers: int = 4
    """Layers of quadrilaterals, cut into triangles, that lie around a body like the rings of an onion."""
    layer_height: float = 0.0235
    """Height of the innermost layer, in L."""
    layer_growth: float = 1.25
    """Height of a layer by that of the one within."""
    wake: float = 0.16
    """Length of the sides behind the bodies, in L."""
    wake_axis: float | None = None
    """Height y of the wake's axis, in the case's unit of length; the bodies' middle when not given."""
    far: float = 1.0
    """Length of the sides far from the bodies, in L."""
    near: tuple[Near, ...] = ()
    """Sides of the domain near which triangles are smaller."""

    @classmethod
    def at(cls, reynolds: float, **others: Any) -> "Sizes":
        """Return sizes for a wake at a Reynolds number: past 100 layers are as thin as boundary layers, 1 / sqrt(Re).

        Facets and the wake's triangles shrink with its fourth root (docs/numerics.md, "Sizes and steps"). others: sizes
        that are given. ValueError where the number is not positive.
        """
        if not reynolds > 0:
            raise ValueError(f"reynolds: got {reynolds:g}, wanted a positive number")
        thin = math.sqrt(min(RESOLVED / reynolds, 1.0))
        sizes = {"layer_height": cls.layer_height * thin} | {
            name: getattr(cls, name) * math.sqrt(thin) for name in ("body", "wake")
        }
        return cls(**sizes | others)


@dataclass(frozen=True)
class Case:
    """One two-dimensional incompressible flow. Lengths and times are in whatever unit the file chooses.

    Raises ValueError at construction when parts do not fit together, with the remedy (`case.checks`).
    """

    reynolds: float
    """Re = U L / nu, with the case's scales."""
    domain: Domain
    conditions: tuple[Condition, ...]
    bodies: tuple[Body, ...] = ()
    actuators: tuple[Input, ...] = ()
    disturbances: tuple[Noise, ...] = ()
    sensors: tuple[Sensor, ...] = ()
    scales: Scales = Scales()
    sizes: Sizes = Sizes()
    mesh: Msh | None = None
    """A mesh from a file, in the place of one of these sizes; the time step of the scheme is then for the default's."""
    scheme: Scheme = BDF2_MEAN
    """Scheme of the time stepping, by its name."""
    time_step: float | None = None
    """Time step, in the case's unit of time; when not given the scheme's own, shorter past Re 100 (`dt`)."""
    spin_up: float = 160.0
    """Time from a kicked rest to the developed flow, in convective units L / U."""

    def __post_init__(self) -> None:
        for name in ("conditions", "bodies", "actuators", "disturbances", "sensors"):
            object.__setattr__(self, name, tuple(getattr(self, name)))  # lists come from keyword arguments
        if isinstance(self.reynolds, float) and self.reynolds.is_integer():
            object.__setattr__(self, "reynolds", int(self.reynolds))  # 100 and 100.0 are one flow, and hash alike
        checks.check(self)

    @property
    def inputs(self) -> tuple[Input, ...]:
        """All that drives the flow: what the agent does, then what chance does."""
        return (*self.actuators, *(noise.by for noise in self.disturbances))

    @property
    def viscosity(self) -> float:
        return self.scales.length * self.scales.velocity / self.reynolds

    @property
    def convective_time(self) -> float:
        """L / U."""
        return self.scales.length / self.scales.velocity

    @property
    def dt(self) -> float:
        """The time step: the one that is given, or the scheme's, cut into equal parts past Re 100 and on finer sizes.

        A whole number of parts, so that an interval that suits the scheme's step suits this one.
        """
        if self.time_step is not None:
            return self.time_step
        finest = min(self.sizes.body / Sizes.body, self.sizes.wake / Sizes.wake, 1.0) if self.bodies else 1.0
        parts = math.ceil((self.reynolds / RESOLVED) ** STEEP / math.sqrt(finest) - LENIENT)
        return self.scheme.time_step * self.convective_time / max(parts, 1)

    @property
    def outlet(self) -> bool:
        """Whether there is a boundary that anything can flow out through."""
        return any(isinstance(condition, Outflow) for condition in self.conditions)

    def body(self, name: str) -> Body | None:
        """Return the body that a piece belongs to, None for a side of the domain."""
        return next((body for body in self.bodies if body.name == name.partition(".")[0]), None)


def readings(case: Case) -> tuple[str, ...]:
    """Return the names of all readings: c_d, c_l, c_m in total and of each body, the power, the sensors' integrals.

    C = 2F / (rho U^2 L), force on the body, drag along x, lift along y; moment about the body's centre, over L too,
    counter-clockwise positive. C_P = 2P / (rho U^3 L), of the actuators.
    """
    kinds = ("c_d", "c_l", "c_m") if case.bodies else ()
    each = tuple(f"{kind}.{body.name}" for body in case.bodies for kind in kinds)
    return (*kinds, *each, "power", *(sensor.name for sensor in integrals(case.sensors)))
