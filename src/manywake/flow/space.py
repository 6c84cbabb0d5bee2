"""Taylor-Hood elements: P2 velocity and P1 pressure on triangles, isoparametric at curved bodies, by scikit-fem."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
import skfem
from skfem.helpers import dot, grad

from manywake.flow.kernels import CORNER
from manywake.flow.mesh import Mesh


class Curved(skfem.MeshTri2):
    """Quadratic triangles; points are looked for in the straight ones of the same vertices.

    That finds the right triangle for every point of the fluid where chords lie inside the bodies, as those of convex
    ones do.
    """

    def element_finder(self, mapping=None):
        return skfem.MeshTri(np.ascontiguousarray(self.doflocs[:, : self.nvertices]), self.t).element_finder()


@dataclass(frozen=True)
class Space:
    """The finite-element spaces on a mesh and the matrices that depend on nothing else.

    `n` velocity nodes (P2: vertices and edge midpoints) and `m` pressure nodes (P1: vertices), numbered as
    scikit-fem does. x: (n, 2) positions of the velocity nodes. nodes: (elements, 6) their numbers, vertices first.
    mass, stiffness: (n, n) for one velocity component. divergence: pair of (m, n), (q, du/dx) and (q, dv/dy).
    pressure_stiffness: (m, m). curved: numbers of the elements with a curved facet. inverse: (elements, 4),
    inverse Jacobian times its absolute determinant, row by row, of the straight elements. curved_inverse:
    (curved, 7, 4), the same at the quadrature points of the curved ones.
    """

    mesh: Mesh
    velocity: skfem.CellBasis
    pressure: skfem.CellBasis
    x: np.ndarray
    nodes: np.ndarray
    inverse: np.ndarray
    curved: np.ndarray
    curved_inverse: np.ndarray
    mass: sp.csr_matrix
    stiffness: sp.csr_matrix
    divergence: tuple[sp.csr_matrix, sp.csr_matrix]
    pressure_stiffness: sp.csr_matrix

    def facets(self, name: str) -> np.ndarray:
        """Return scikit-fem's facet numbers of a named boundary."""
        pairs = np.sort(self.mesh.boundaries[name], axis=1)
        return np.array([self._facet_numbers[int(a), int(b)] for a, b in pairs])

    @cached_property
    def _facet_numbers(self) -> dict[tuple[int, int], int]:
        return {(int(a), int(b)): k for k, (a, b) in enumerate(np.sort(self.velocity.mesh.facets.T, axis=1))}

    def boundary_nodes(self, names: list[str]) -> np.ndarray:
        """Return the velocity nodes of the named boundaries, sorted."""
        facets = [self.facets(name) for name in names]
        return np.unique(self.velocity.get_dofs(np.concatenate(facets)).all()) if facets else np.empty(0, int)

    def boundary_vertices(self, name: str) -> np.ndarray:
        """Return the pressure nodes of a named boundary, sorted."""
        return np.unique(self.mesh.boundaries[name])


def build(mesh: Mesh) -> Space:
    """Set up the spaces and assemble their matrices."""
    skmesh = skfem.MeshTri(mesh.points.T.copy(), mesh.triangles.T.copy())
    if len(mesh.middles()[0]):
        skmesh = _curve(skmesh, mesh)
    velocity = skfem.Basis(skmesh, skfem.ElementTriP2(), intorder=5)
    pressure = velocity.with_element(skfem.ElementTriP1())

    @skfem.BilinearForm
    def mass(u, v, w):
        return u * v

    @skfem.BilinearForm
    def stiffness(u, v, w):
        return dot(grad(u), grad(v))

    def divergence(c):
        return skfem.BilinearForm(lambda u, q, w: q * u.grad[c])

    nodes, x = velocity.element_dofs.T.copy(), velocity.doflocs.T.copy()
    straight = (x[nodes[:, :3]] + x[nodes[:, [1, 2, 0]]]) / 2
    curved = np.flatnonzero((abs(x[nodes[:, 3:]] - straight) > 1e-12).any(axis=(1, 2)))
    return Space(
        mesh,
        velocity,
        pressure,
        x,
        nodes,
        _inverse(x[nodes], CORNER[:1])[:, 0],
        curved,
        _inverse(x[nodes[curved]], CORNER),
        _clean(mass.assemble(velocity)),
        _clean(stiffness.assemble(velocity)),
        (
            _clean(divergence(0).assemble(velocity, pressure)),
            _clean(divergence(1).assemble(velocity, pressure)),
        ),
        _clean(stiffness.assemble(pressure)),
    )


def _curve(skmesh: skfem.MeshTri, mesh: Mesh) -> Curved:
    """Return the mesh with the middle of each curved facet moved out to its curve."""
    known = {(int(a), int(b)): k for k, (a, b) in enumerate(skmesh.facets.T)}
    facets, x = mesh.middles()
    middles = len(mesh.points) + np.array([known[min(a, b), max(a, b)] for a, b in facets.tolist()])
    curved = Curved.from_mesh(skmesh)
    curved.doflocs[:, middles] = x.T
    return curved


def _inverse(x: np.ndarray, corner: np.ndarray) -> np.ndarray:
    """Return the inverse Jacobian times its absolute determinant, (elements, q, 4).

    x: (elements, 6, 2) positions of the nodes. corner: (q, 3) barycentric coordinates of the points.
    """
    l0, l1, l2 = corner.T
    zero = np.zeros_like(l0)
    xi = np.stack([1 - 4 * l0, 4 * l1 - 1, zero, 4 * (l0 - l1), 4 * l2, -4 * l2])
    eta = np.stack([1 - 4 * l0, zero, 4 * l2 - 1, -4 * l1, 4 * l1, 4 * (l0 - l2)])
    (x_xi, y_xi), (x_eta, y_eta) = (np.einsum("kq,ekc->ceq", slope, x) for slope in (xi, eta))
    # scikit-fem sorts the vertices of a triangle, so it may stand clockwise: hence the sign
    sign = np.sign(x_xi * y_eta - x_eta * y_xi)
    return np.stack([y_eta, -x_eta, -y_xi, x_xi], axis=2) * sign[:, :, None]


def _clean(matrix: sp.spmatrix) -> sp.csr_matrix:
    """Drop entries that are zero but for rounding (P2 vertex functions against P1 gradients, for one)."""
    matrix = sp.csr_matrix(matrix)
    matrix.data[abs(matrix.data) < 1e-13 * abs(matrix.data).max()] = 0.0
    matrix.eliminate_zeros()
    matrix.sort_indices()
    return matrix


def probe_matrix(basis: skfem.CellBasis, points: np.ndarray) -> sp.csr_matrix:
    """Return the matrix (points, nodes) that interpolates a nodal vector at points (k, 2)."""
    return _clean(basis.probes(points.T))


def advection(space: Space, velocity: np.ndarray) -> sp.csr_matrix:
    """Return N (n, n), ((U . grad) psi_k, psi_i) for a velocity U (n, 2) at the nodes."""
    U, V = (space.velocity.interpolate(velocity[:, c]) for c in range(2))
    form = skfem.BilinearForm(lambda u, v, w: (w.U * u.grad[0] + w.V * u.grad[1]) * v)
    return _clean(form.assemble(space.velocity, U=U, V=V))
