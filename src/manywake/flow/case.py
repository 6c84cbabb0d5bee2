"""A case: geometry, fluid, jets, probes and numerics of one flow, as plain frozen data.

Units are those of the paper's code: the mean inflow velocity is 1, the density is 1, the cylinder's diameter is 0.1
and its centre is the origin. So the unit of length is 10 D and that of time 10 D/U-bar. Values: the DFG benchmark
(Schafer & Turek 1996) with the jets and probes of Rabault & Kuhnle (2019).
"""

import dataclasses
import hashlib
import json
import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

RADIUS = 0.05
FULL_RATE = 0.01
"""Flow rate of a jet at full strength (released code: 10 times 1e-3), for which `Scheme.damping` is made."""
EXPLICIT_LIMIT, MEAN_LIMIT = 6e-4, 1.25e-3
"""Largest time steps on the shipped mesh, with explicit convection and with the mean flow's implicit."""


def paper_probes() -> tuple[tuple[float, float], ...]:
    """Return the positions (x, y) of the paper's 151 probes, in the order of its observation vector."""
    wake = [
        (x, y)
        for x in (0.075, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45)
        for y in (-0.15, -0.1, -0.05, 0.0, 0.05, 0.1, 0.15)
    ]
    beside = [(x, y) for x in (-0.025, 0.0, 0.025, 0.05) for y in (-0.15, -0.1, 0.1, 0.15)]
    rings = [
        (r * math.cos(math.radians(angle)), r * math.sin(math.radians(angle)))
        for r in (RADIUS + 0.02, RADIUS + 0.05)
        for angle in range(0, 360, 10)
    ]
    # ten digits: the same on every libm
    return tuple((round(x, 10), round(y, 10)) for x, y in wake + beside + rings)


@dataclass(frozen=True)
class Jet:
    """One jet on the cylinder; its flow rate Q blows for Q > 0 and sucks for Q < 0."""

    angle: float
    """Centre of the jet on the cylinder, in degrees from the downstream direction."""
    width: float = 10.0
    """Angular width in degrees (paper, section 2.1)."""


@dataclass(frozen=True)
class Resolution:
    """Sizes of the triangles, in the unit of length, 10 D."""

    cylinder: float = 0.0048
    """Length of the facets of the cylinder."""
    layers: int = 3
    """Layers of quadrilaterals, cut into triangles, that lie around the cylinder like the rings of an onion."""
    layer_height: float = 0.0034
    """Height of the innermost layer."""
    layer_growth: float = 1.25
    """Height of a layer by that of the one within."""
    wake: float = 0.0155
    """Within 0.3 behind the cylinder."""
    far: float = 0.08
    """At the end of the channel."""
    jet_facets: int = 2
    """Facets across a jet; two resolve its flux to 0.22 % before scaling, one to 4 %."""


@dataclass(frozen=True)
class Scheme:
    """Coefficients of the time stepping, docs/numerics.md eq. 4-7; the names below are the ones to use."""

    name: str
    new: float
    """Weight of u at t + dt in the time derivative."""
    history: tuple[float, float]
    """Minus the weights of u at t and t - dt in the time derivative."""
    ahead: float
    """Steps of the last increment by which u at t is extrapolated to the velocity e that the residual is of: e = u +
    ahead (u - u_old)."""
    pressure: tuple[float, float]
    """Weights of the last two pressure increments in the pressure of the momentum equation."""
    implicit: float
    """Share of the viscous term's increment taken at t + dt; 1/2 is Crank-Nicolson."""
    mean: bool = False
    """Whether advection by the mean flow is taken at t + dt too, so that only the fluctuation is explicit."""
    damping: float = 0.0
    """Near the jets, a viscosity that acts on the error of the extrapolation alone: its size over dt V^2, with V the
    peak velocity of a jet at FULL_RATE."""


BDF2 = Scheme("bdf2", 1.5, (2.0, -0.5), 1.0, (4 / 3, -1 / 3), 1.0)
"""Second order: BDF2 with extrapolated explicit convection."""
BDF2_MEAN = Scheme("bdf2-mean", 1.5, (2.0, -0.5), 1.0, (4 / 3, -1 / 3), 1.0, mean=True, damping=0.5)
"""The default. Second order as BDF2, but the uncontrolled flow's mean advects implicitly, which allows larger steps."""
GODA = Scheme("goda", 1.0, (1.0, 0.0), 0.0, (1.0, 0.0), 0.5)
"""The paper's first-order scheme: forward Euler convection, Crank-Nicolson viscosity (Goda 1979)."""


@dataclass(frozen=True)
class Case:
    """A flow around a cylinder in a channel, with jets on the cylinder and probes in the wake.

    Raises ValueError at construction when a setting is outside what the solver can do, with the remedy.
    """

    name: str
    reynolds: float = 100.0
    """Re = U-bar D / nu with U-bar the mean inflow velocity."""
    jets: tuple[Jet, ...] = (Jet(90.0), Jet(270.0))
    probes: tuple[tuple[float, float], ...] = field(default_factory=paper_probes)
    time_step: float = 1e-3
    scheme: Scheme = BDF2_MEAN
    resolution: Resolution = Resolution()
    radius: float = RADIUS
    x_range: tuple[float, float] = (-0.2, 2.0)
    y_range: tuple[float, float] = (-0.2, 0.21)
    spin_up: float = 16.0
    """Time from a kicked rest to the developed Karman street, whose peaks have then settled to five digits."""

    def __post_init__(self) -> None:
        if not 0 < self.reynolds <= 400:
            raise ValueError(
                f"reynolds: got {self.reynolds:g}, wanted a value in (0, 400]; the flow is two-dimensional, "
                "laminar, and the shipped resolution is made for about 100"
            )
        limit = MEAN_LIMIT if self.scheme.mean else EXPLICIT_LIMIT
        if not 0 < self.time_step <= limit:
            raise ValueError(
                f"time_step: got {self.time_step:g}, wanted a value in (0, {limit:g}]; scheme {self.scheme.name!r} is "
                "unstable above on the shipped mesh"
            )
        # lists come from keyword arguments and JSON; tuples can be hashed
        object.__setattr__(self, "probes", tuple((float(x), float(y)) for x, y in self.probes))
        object.__setattr__(self, "jets", tuple(self.jets))
        edges = sorted((jet.angle % 360, jet.width) for jet in self.jets)
        for (angle, width), (after, next_width) in zip(edges, [*edges[1:], *edges[:1]], strict=True):
            gap = (after - angle) % 360 if len(edges) > 1 else 360.0
            if not 0 < width <= 90 or (width + next_width) / 2 > gap:
                raise ValueError(
                    f"jets: got one at {angle:g} degrees of width {width:g}, wanted widths in (0, 90] without overlap"
                )
        if not self.spin_up > 0:
            raise ValueError(f"spin_up: got {self.spin_up:g}, wanted a positive time; the street needs about 12")
        for i, (x, y) in enumerate(self.probes):
            inside = self.x_range[0] <= x <= self.x_range[1] and self.y_range[0] <= y <= self.y_range[1]
            # a little off the circle, to which the arcs are parabolas
            if not inside or math.hypot(x, y) < 1.002 * self.radius:
                where = "inside the cylinder" if inside else "outside the channel"
                raise ValueError(
                    f"probe {i}: got ({x:g}, {y:g}), which is {where}; wanted a point in the fluid, at least "
                    f"{1.002 * self.radius:g} from the centre, x in {self.x_range}, y in {self.y_range}"
                )

    @property
    def diameter(self) -> float:
        return 2 * self.radius

    @property
    def height(self) -> float:
        return self.y_range[1] - self.y_range[0]

    @property
    def viscosity(self) -> float:
        return self.diameter / self.reynolds

    def inflow(self, y: np.ndarray) -> np.ndarray:
        """Return the inflow velocity at `y`: a parabola of mean 1 and maximum 1.5."""
        low, high = self.y_range
        return 6.0 * (y - low) * (high - y) / self.height**2

    def settings(self) -> dict[str, Any]:
        """Return all settings as plain data, for files and hashes."""
        return dataclasses.asdict(self)

    def flow_digest(self) -> str:
        """Return a hash of all that decides the uncontrolled flow: the settings but for the name and the probes."""
        flow = {key: value for key, value in self.settings().items() if key not in ("name", "probes")}
        return hashlib.sha256(json.dumps(flow, sort_keys=True).encode()).hexdigest()


CASES: dict[str, Case] = {
    case.name: case
    for case in (
        Case("cylinder-jets"),
        Case("cylinder-jets-goda", scheme=GODA, time_step=5e-4),
    )
}
"""The shipped cases by name: the paper's geometry with the default scheme, and with the paper's scheme."""


def by_name(name: str) -> Case:
    """Return a shipped case; ValueError names those there are."""
    if name not in CASES:
        raise ValueError(f"case: got {name!r}, wanted one of {', '.join(sorted(CASES))}")
    return CASES[name]
