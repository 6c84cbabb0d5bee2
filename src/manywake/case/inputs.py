"""Inputs: what drives a flow, from its boundary or inside it, linear in one amplitude each; and chance, which may."""

import math
from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np

from manywake.case.conditions import Condition, Stream
from manywake.case.geometry import Body, Chart, Point, Side


@dataclass(frozen=True)
class Input:
    """What one amplitude drives. Amplitudes, in `unit`, stay within +- limit.

    on: what it acts on, as `acts` says: a piece of a boundary, a whole body, a side of the domain. An input of the
    fluid has a name of its own there. flux: volume per time that an amplitude of 1 brings into the fluid, None where
    its velocity is imposed as it is.
    """

    on: str
    limit: float = math.inf
    strength: float | None = field(default=None, kw_only=True)
    """Amplitude that the flow is made stable for, the limit when not given. Limits below it share its baseline."""
    unit: ClassVar[str]
    acts: ClassVar[Literal["piece", "body", "side", "fluid"]]
    flux: ClassVar[float | None] = None

    @property
    def strongest(self) -> float:
        return self.limit if self.strength is None else self.strength

    def velocity(self, of: Body | Side, chart: Chart | None, x: np.ndarray) -> np.ndarray:
        """Return the velocity (k, 2) at points (k, 2) of the boundary at amplitude 1.

        of: the body or the side of the domain that the points are on. chart: where on the piece they are, None for a
        whole body.
        """
        raise NotImplementedError


class Jet(Input):
    """A slot that blows along the wall's normal where its flow rate is positive, and sucks where it is negative.

    The profile is half a cosine wave, zero at the ends of the piece, scaled so that an amplitude of 1 is a flow rate of
    1 per unit depth (docs/numerics.md, eq. 12).
    """

    unit = "flow rate per unit depth, blowing positive"
    acts = "piece"
    flux = 1.0

    def velocity(self, of, chart, x):
        shape = np.maximum(np.cos(np.pi * chart.offset / chart.width), 0.0) * np.pi / (2 * chart.length)
        shape[abs(abs(chart.offset) - chart.width / 2) < 1e-9 * max(chart.width, 1.0)] = 0.0
        return shape[:, None] * chart.outward / np.linalg.norm(chart.outward, axis=1)[:, None]


class Rotation(Input):
    """A body that turns about its centre, counter-clockwise where the angular velocity is positive."""

    unit = "angular velocity, counter-clockwise positive"
    acts = "body"

    def velocity(self, of, chart, x):
        from_centre = x - np.array(of.centre)
        return np.stack([-from_centre[:, 1], from_centre[:, 0]], axis=1)


@dataclass(frozen=True)
class Gust(Input):
    """More velocity on a side of given velocity: a gust at an inflow, a wall that moves faster.

    Where the side meets another the later condition wins, as everywhere: the gust is zero there if that is not its
    side's. Of two gusts on sides of one condition it is the later gust.
    """

    profile: Condition = Stream()
    """The velocity at amplitude 1: a condition without names, as Stream(x=0.0, y=1.0) across, Parabola(mean=1.0)."""
    unit = "times its profile"
    acts = "side"

    def velocity(self, of, chart, x):
        return self.profile.velocity(of, x)  # type: ignore[union-attr]


@dataclass(frozen=True)
class BodyForce(Input):
    """A force per unit mass inside the fluid, at amplitude 1: along exp(-|x - at|^2 / radius^2)."""

    at: Point = field(kw_only=True)
    radius: float = field(kw_only=True)
    along: Point = field(default=(1.0, 0.0), kw_only=True)
    unit = "force per unit mass"
    acts = "fluid"

    def force(self, x: np.ndarray) -> np.ndarray:
        """Return the force (..., 2) at points (..., 2) at amplitude 1."""
        squared = ((x - np.array(self.at)) ** 2).sum(axis=-1)
        return np.exp(-squared / self.radius**2)[..., None] * np.array(self.along)


@dataclass(frozen=True)
class Noise:
    """Chance drives an input: filtered noise of zero mean, drawn from the episode's seed (docs/numerics.md, eq. 20).

    Where the input has a limit, the noise is cut off there.
    """

    by: Input
    rms: float
    """Root mean square of the amplitude."""
    time: float
    """Time in which its correlation falls to 1/e, in the case's unit of time."""
