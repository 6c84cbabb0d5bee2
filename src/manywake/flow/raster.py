"""Fields of a flow as pixels, for eyes: points are located once, then a picture is two sparse products."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import skfem

from manywake.case.case import Case
from manywake.case.geometry import outline
from manywake.flow.batch import Start
from manywake.flow.mesh import Mesh
from manywake.flow.space import Space, gathering, quadratic

BEFORE, BEHIND, BESIDE = 2.5, 15.5, 5.0
"""How far from the bodies a picture reaches, in L, where the flow does; behind a step as far from its edge."""
SLIMMEST = 1 / 5
"""Least height of a picture by its width; a longer channel is stretched across."""


@dataclass(frozen=True)
class View:
    """A rectangle of the flow, in the case's unit of length, and how many pixels it has."""

    x: tuple[float, float]
    y: tuple[float, float]
    width: int
    height: int

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Return where points (k, 2) of the flow are in the picture, (k, 2): from the left, and from the top."""
        (x0, x1), (y0, y1) = self.x, self.y
        return np.stack(
            [(points[:, 0] - x0) / (x1 - x0) * self.width, (y1 - points[:, 1]) / (y1 - y0) * self.height], axis=1
        )

    def centres(self) -> np.ndarray:
        """Return the places of the pixels' centres, (height * width, 2), row by row from the top."""
        (x0, x1), (y0, y1) = self.x, self.y
        x = x0 + (np.arange(self.width) + 0.5) / self.width * (x1 - x0)
        y = y1 - (np.arange(self.height) + 0.5) / self.height * (y1 - y0)
        return np.stack([part.ravel() for part in np.meshgrid(x, y)], axis=1)


def framed(case: Case, mesh: Mesh, width: int) -> View:
    """Return the part of a flow that is worth a look, on a picture of so many pixels across, even in height."""
    low, high = mesh.points.min(axis=0), mesh.points.max(axis=0)
    rims = [outline(body) for body in case.bodies]
    if rims:
        around, length = np.concatenate(rims), case.scales.length
        low = np.maximum(low, around.min(axis=0) - length * np.array([BEFORE, BESIDE]))
        high = np.minimum(high, around.max(axis=0) + length * np.array([BEHIND, BESIDE]))
    else:
        corners = [x for side in case.domain.sides() for x, _ in (side.start, side.end) if x < high[0]]
        high[0] = min(high[0], max(corners) + BEHIND * case.scales.length)
    across, along = float(high[1] - low[1]), float(high[0] - low[0])
    height = 2 * round(width * max(across / along, SLIMMEST) / 2)
    return View((float(low[0]), float(high[0])), (float(low[1]), float(high[1])), width, height)


class Raster:
    """The pixels of a view that lie in the fluid: `fluid`, (height, width)."""

    def __init__(self, space: Space, view: View):
        self.view = view
        places = view.centres()
        element, corners = _located(space, places)
        there = element >= 0
        self.fluid = there.reshape(view.height, view.width)
        nodes, corners = space.nodes[element[there]], corners[there]
        self._interpolate = gathering(nodes, quadratic(corners).astype(np.float32), len(space.x))
        self._interpolate_linear = gathering(nodes[:, :3], corners.astype(np.float32), len(space.mesh.points))
        self._slopes = _slopes(space)

    def vorticity(self, state: Start) -> np.ndarray:
        """Return dv/dx - du/dy, (height, width) float32, in the case's units, 0 outside of the fluid.

        Its values at the nodes are means over the triangles there.
        """
        u = state.u.astype(np.float32)
        return self._placed(self._interpolate @ (self._slopes[0] @ u[:, 1] - self._slopes[1] @ u[:, 0]))

    def speed(self, state: Start) -> np.ndarray:
        """Return |u|, as `vorticity`."""
        u, v = (self._interpolate @ state.u.astype(np.float32)).T
        return self._placed(np.hypot(u, v))

    def pressure(self, state: Start) -> np.ndarray:
        """Return p, as `vorticity`."""
        return self._placed(self._interpolate_linear @ state.p.astype(np.float32))

    def _placed(self, values: np.ndarray) -> np.ndarray:
        """Return values (k,) of the pixels in the fluid as a picture, 0 elsewhere."""
        picture = np.zeros(self.fluid.shape, np.float32)
        picture[self.fluid] = values
        return picture


def _located(space: Space, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the triangle of each place (k,), -1 where there is none, and the barycentric coordinates (k, 3)."""
    from matplotlib.tri import Triangulation

    x, vertices = space.x[: len(space.mesh.points)], space.nodes[:, :3]
    element = np.asarray(Triangulation(x[:, 0], x[:, 1], vertices).get_trifinder()(*places.T))
    a, b, c = np.moveaxis(x[vertices[element]], 1, 0)

    def area(p, q, r):
        return (q[:, 0] - p[:, 0]) * (r[:, 1] - p[:, 1]) - (r[:, 0] - p[:, 0]) * (q[:, 1] - p[:, 1])

    whole = area(a, b, c)
    return element, np.stack([area(places, b, c), area(a, places, c), area(a, b, places)], axis=1) / whole[:, None]


def _slopes(space: Space) -> list[sp.csr_matrix]:
    """Return the matrices (n, n) that give d/dx and d/dy at the nodes, means over the triangles there by their area."""
    lumped = skfem.BilinearForm(lambda u, v, w: 1.0 * u * v)
    corners = np.array([(1.0, 0, 0), (0, 1, 0), (0, 0, 1), (0.5, 0.5, 0), (0, 0.5, 0.5), (0.5, 0, 0.5)])
    points = corners[:, 1:].T
    basis = skfem.Basis(space.velocity.mesh, skfem.ElementTriP2(), quadrature=(points, np.full(6, 1 / 12)))
    # the points are the nodes, so that v there is 1 at its own and 0 at the others
    weight = 1.0 / np.asarray(lumped.assemble(basis).diagonal())
    found = []
    for c in range(2):
        slope = skfem.BilinearForm(lambda u, v, w, c=c: u.grad[c] * v).assemble(basis)
        found.append(sp.csr_matrix(sp.diags(weight) @ slope, dtype=np.float32))
    return found
