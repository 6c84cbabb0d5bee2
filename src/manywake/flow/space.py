"""Taylor-Hood elements: P2 velocity and P1 pressure on straight triangles, by scikit-fem."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import skfem
from skfem.helpers import dot, grad

from manywake.flow.mesh import Mesh


@dataclass(frozen=True)
class Space:
    """The finite-element spaces on a mesh and the matrices that depend on nothing else.

    `n` velocity nodes (P2: vertices and edge midpoints) and `m` pressure nodes (P1: vertices), numbered as
    scikit-fem does. x: (n, 2) positions of the velocity nodes. nodes: (elements, 6) their numbers, vertices first.
    mass, stiffness: (n, n) for one velocity component. divergence: pair of (m, n), (q, du/dx) and (q, dv/dy).
    pressure_stiffness: (m, m). inverse: (elements, 4), inverse Jacobian times its absolute determinant, row by row.
    """

    mesh: Mesh
    velocity: skfem.CellBasis
    pressure: skfem.CellBasis
    x: np.ndarray
    nodes: np.ndarray
    inverse: np.ndarray
    mass: sp.csr_matrix
    stiffness: sp.csr_matrix
    divergence: tuple[sp.csr_matrix, sp.csr_matrix]
    pressure_stiffness: sp.csr_matrix

    def facets(self, name: str) -> np.ndarray:
        """Return scikit-fem's facet numbers of a named boundary."""
        pairs = np.sort(self.mesh.boundaries[name], axis=1)
        known = {(int(a), int(b)): k for k, (a, b) in enumerate(np.sort(self.velocity.mesh.facets.T, axis=1))}
        return np.array([known[int(a), int(b)] for a, b in pairs])

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
    velocity = skfem.Basis(skmesh, skfem.ElementTriP2(), intorder=4)
    pressure = velocity.with_element(skfem.ElementTriP1())

    @skfem.BilinearForm
    def mass(u, v, w):
        return u * v

    @skfem.BilinearForm
    def stiffness(u, v, w):
        return dot(grad(u), grad(v))

    def divergence(c):
        return skfem.BilinearForm(lambda u, q, w: q * u.grad[c])

    # scikit-fem sorts the vertices of a triangle, so it may stand clockwise: hence the sign
    a, b, c = (mesh.points[vertices] for vertices in skmesh.t)
    (j00, j10), (j01, j11) = (b - a).T, (c - a).T
    sign = np.sign(j00 * j11 - j01 * j10)
    return Space(
        mesh,
        velocity,
        pressure,
        velocity.doflocs.T.copy(),
        velocity.element_dofs.T.copy(),
        np.stack([j11, -j01, -j10, j00], axis=1) * sign[:, None],
        _clean(mass.assemble(velocity)),
        _clean(stiffness.assemble(velocity)),
        (
            _clean(divergence(0).assemble(velocity, pressure)),
            _clean(divergence(1).assemble(velocity, pressure)),
        ),
        _clean(stiffness.assemble(pressure)),
    )


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
