"""Inputs: what drives a flow from its boundary, a velocity profile that is linear in one amplitude, with a limit."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from manywake.case.geometry import Body, Chart


@dataclass(frozen=True)
class Input:
    """An actuator on a piece of a boundary. Amplitudes, in `unit`, stay within +- limit.

    flux: volume per time that an amplitude of 1 brings into the fluid, None for an input that turns a whole body.
    """

    on: str
    limit: float
    strength: float | None = None
    """Amplitude that the flow is made stable for, the limit when not given. Limits below it share its baseline."""
    unit: ClassVar[str]
    flux: ClassVar[float | None]

    @property
    def strongest(self) -> float:
        return self.limit if self.strength is None else self.strength

    def velocity(self, body: Body | None, chart: Chart | None, x: np.ndarray) -> np.ndarray:
        """Return the velocity (k, 2) at points (k, 2) of the piece at amplitude 1.

        body: whose piece it is, None for a side of the domain. chart: where on the piece the points are, None for a
        whole body.
        """
        raise NotImplementedError


class Jet(Input):
    """A slot that blows along the wall's normal where its flow rate is positive, and sucks where it is negative.

    The profile is half a cosine wave, zero at the ends of the piece, scaled so that an amplitude of 1 is a flow rate of
    1 per unit depth (docs/numerics.md, eq. 12).
    """

    unit = "flow rate per unit depth, blowing positive"
    flux = 1.0

    def velocity(self, body, chart, x):
        shape = np.maximum(np.cos(np.pi * chart.offset / chart.width), 0.0) * np.pi / (2 * chart.length)
        shape[abs(abs(chart.offset) - chart.width / 2) < 1e-9 * max(chart.width, 1.0)] = 0.0
        return shape[:, None] * chart.outward / np.linalg.norm(chart.outward, axis=1)[:, None]


class Rotation(Input):
    """A body that turns about its centre, counter-clockwise where the angular velocity is positive."""

    unit = "angular velocity, counter-clockwise positive"
    flux = None

    def velocity(self, body, chart, x):
        from_centre = x - np.array(body.centre)
        return np.stack([-from_centre[:, 1], from_centre[:, 0]], axis=1)
