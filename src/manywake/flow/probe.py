"""Fields of one flow looked at along lines: extrema of the velocity, and where the shear on a wall changes sign."""

from dataclasses import dataclass

import numpy as np
import skfem
from scipy.optimize import brentq, minimize_scalar

from manywake.case.geometry import Point, Side
from manywake.flow import space as spaces
from manywake.flow.space import Space

SAMPLES = 1000
"""Points of a line at which a field is looked at before its extremum or its zeros are narrowed down."""
ASIDE = 1e-7
"""Points of a side, and ends of a line, are taken this share of its length within, where rounding cannot lose them."""


@dataclass(frozen=True)
class Field:
    """One flow, u (n, 2) in scikit-fem's order, as a function of the place."""

    space: Space
    u: np.ndarray

    def velocity(self, points: np.ndarray) -> np.ndarray:
        """Return the velocity (k, 2) at points (k, 2)."""
        return spaces.probe_matrix(self.space.velocity, points) @ self.u

    def gradient(self, points: np.ndarray) -> np.ndarray:
        """Return the gradient (k, 2, 2), d u_i / d x_j, in the triangle that each of the points (k, 2) is in."""
        basis = self.space.velocity
        mesh, element, mapping = basis.mesh, skfem.ElementTriP2(), basis.mapping
        cells = mesh.element_finder(mapping=mapping)(*points.T)
        local = mapping.invF(points.T[:, :, None], tind=cells)
        slopes = [element.gbasis(mapping, local, k, tind=cells)[0].grad[:, :, 0] for k in range(6)]
        return np.einsum("kjp,pki->pij", np.array(slopes), self.u[self.space.nodes[cells]])

    def shear(self, side: Side, points: np.ndarray) -> np.ndarray:
        """Return the slope (k,) of the velocity along a side, counter-clockwise positive, with the distance from it."""
        chart = side.chart(points)
        into = chart.outward
        along = np.stack([into[:, 1], -into[:, 0]], axis=1)
        return np.einsum("pij,pi,pj->p", self.gradient(points + ASIDE * chart.length * into), along, into)


def extremum(field: Field, start: Point, end: Point, component: int, sign: float) -> float:
    """Return the largest (sign 1) or smallest (sign -1) value of a component of the velocity on a line.

    The line lies in the fluid; its ends may be on walls.
    """
    a, b = np.array(start, dtype=float), np.array(end, dtype=float)

    def value(share):
        return -sign * field.velocity(a + np.atleast_1d(share)[:, None] * (b - a))[:, component]

    shares = np.linspace(ASIDE, 1.0 - ASIDE, SAMPLES + 1)
    sampled = value(shares)
    k = int(sampled.argmin())
    around = shares[max(k - 1, 0)], shares[min(k + 1, SAMPLES)]
    found = minimize_scalar(lambda share: float(value(share)[0]), bounds=around, method="bounded")
    return float(-sign * min(found.fun, sampled[k]))


def changes(field: Field, side: Side, start: Point, end: Point) -> np.ndarray:
    """Return how far from `start` the shear on a side changes its sign between two of its points, in order."""
    a, b = np.array(start, dtype=float), np.array(end, dtype=float)
    length = float(np.linalg.norm(b - a))

    def shear(share):
        return field.shear(side, a + np.atleast_1d(share)[:, None] * (b - a))

    shares = (np.arange(SAMPLES) + 0.5) / SAMPLES
    sign = np.sign(shear(shares))
    found = np.flatnonzero(sign[1:] * sign[:-1] < 0)
    roots = [brentq(lambda share: float(shear(share)[0]), shares[k], shares[k + 1], xtol=1e-9) for k in found]
    return length * np.array(roots)
