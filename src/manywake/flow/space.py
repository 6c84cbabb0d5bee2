"""Taylor-Hood elements: P2 velocity and P1 pressure on triangles, isoparametric at curved bodies, by scikit-fem."""

import numpy as np
import scipy.sparse as sp
import skfem
from scipy.spatial import cKDTree
from skfem.helpers import dot, grad

from manywake.flow.kernels import CORNER
from manywake.flow.mesh import Mesh


class Curved(skfem.MeshTri2):
    """Quadratic triangles; points are looked for in the straight ones of the same vertices.

    That finds the right triangle for all points of the fluid where chords lie inside the bodies, as of convex ones.
    """

    def element_finder(self, mapping=None):
        return skfem.MeshTri(np.ascontiguousarray(self.doflocs[:, : self.nvertices]), self.t).element_finder()


class Space:
    """The finite-element spaces on a mesh and the matrices that depend on nothing else.

    `n` velocity nodes (P2: vertices and edge midpoints) and `m` pressure nodes (P1: vertices), numbered as
    scikit-fem does. x: (n, 2) positions of the velocity nodes. nodes: (elements, 6) their numbers, vertices first.
    mass, stiffness: (n, n) for one velocity component. divergence: pair of (m, n), (q, du/dx) and (q, dv/dy).
    pressure_stiffness: (m, m). curved: numbers of the elements with a curved facet. inverse: (elements, 4),
    inverse Jacobian times its absolute determinant, row by row, of the straight elements. curved_inverse:
    (curved, 7, 4), the same at the quadrature points of the curved ones.
    """

    def __init__(self, mesh: Mesh):
        skmesh = skfem.MeshTri(mesh.points.T.copy(), mesh.triangles.T.copy())
        facets, middles = mesh.middles()
        if len(facets):
            ends, skmesh = _numbers(skmesh, facets), Curved.from_mesh(skmesh)
            skmesh.doflocs[:, len(mesh.points) + ends] = middles.T
        self.mesh = mesh
        self.velocity = skfem.Basis(skmesh, skfem.ElementTriP2(), intorder=5)
        self.pressure = self.velocity.with_element(skfem.ElementTriP1())
        self.x, self.nodes = self.velocity.doflocs.T.copy(), self.velocity.element_dofs.T.copy()
        corners, edges = np.split(self.x[self.nodes], 2, axis=1)
        straight = (corners + corners[:, [1, 2, 0]]) / 2
        self.curved = np.flatnonzero((abs(edges - straight) > 1e-12).any(axis=(1, 2)))
        self.inverse = _inverse(self.x[self.nodes], CORNER[:1])[:, 0]
        self.curved_inverse = _inverse(self.x[self.nodes[self.curved]], CORNER)

        mass = skfem.BilinearForm(lambda u, v, w: u * v)
        stiffness = skfem.BilinearForm(lambda u, v, w: dot(grad(u), grad(v)))
        slopes = [skfem.BilinearForm(lambda u, q, w, c=c: q * u.grad[c]) for c in range(2)]
        self.mass, self.stiffness = clean(mass.assemble(self.velocity)), clean(stiffness.assemble(self.velocity))
        self.divergence = [clean(slope.assemble(self.velocity, self.pressure)) for slope in slopes]
        self.pressure_stiffness = clean(stiffness.assemble(self.pressure))

    def facets(self, *names: str) -> np.ndarray:
        """Return scikit-fem's facet numbers of named boundaries, one after the other."""
        return _numbers(self.velocity.mesh, np.concatenate([self.mesh.boundaries[name] for name in names]))

    def boundary_nodes(self, names: list[str]) -> np.ndarray:
        """Return the velocity nodes of the named boundaries, sorted."""
        return np.unique(self.velocity.get_dofs(self.facets(*names)).all()) if names else np.empty(0, int)

    def boundary_vertices(self, name: str) -> np.ndarray:
        """Return the pressure nodes of a named boundary, sorted."""
        return np.unique(self.mesh.boundaries[name])


def _numbers(skmesh: skfem.MeshTri, ends: np.ndarray) -> np.ndarray:
    """Return scikit-fem's numbers of facets with these vertices (f, 2)."""
    known = {(a, b): k for k, (a, b) in enumerate(skmesh.facets.T.tolist())}
    return np.array([known[min(a, b), max(a, b)] for a, b in ends.tolist()])


def build(mesh: Mesh) -> Space:
    """Set up the spaces and assemble their matrices."""
    return Space(mesh)


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


def clean(matrix: sp.spmatrix) -> sp.csr_matrix:
    """Drop entries that are zero but for rounding (P2 vertex functions against P1 gradients, for one)."""
    matrix = sp.csr_matrix(matrix)
    matrix.data[abs(matrix.data) < 1e-13 * abs(matrix.data).max(initial=0.0)] = 0.0
    matrix.eliminate_zeros()
    matrix.sort_indices()
    return matrix


def probe_matrix(basis: skfem.CellBasis, points: np.ndarray) -> sp.csr_matrix:
    """Return the matrix (points, nodes) that interpolates a nodal vector at points (k, 2)."""
    return clean(basis.probes(points.T))


def quadratic(l: np.ndarray) -> np.ndarray:
    """Return the P2 shape functions (k, 6), vertices first, at barycentric coordinates (k, 3)."""
    return np.hstack([l * (2 * l - 1), 4 * l * l[:, [1, 2, 0]]])


def gathering(nodes: np.ndarray, shapes: np.ndarray, columns: int) -> sp.csr_matrix:
    """Return the matrix (k, columns) that sums a nodal vector over some nodes (k, j) with their shapes (k, j)."""
    first = np.arange(0, shapes.size + 1, shapes.shape[1])
    return sp.csr_matrix((shapes.ravel(), nodes.ravel(), first), (len(shapes), columns))


def carrying(space: Space, to: Space) -> tuple[sp.csr_matrix, sp.csr_matrix]:
    """Return the matrices that carry velocities (n,) and pressures (m,) to another mesh.

    to: on the mesh that is refined from this one, or that this one is refined from.
    """
    l = np.array([(i, j, 4 - i - j) for i in range(5) for j in range(5 - i)]) / 4  # where the nodes of quarters are
    shapes = quadratic(l)
    _, near = cKDTree((shapes @ space.x[space.nodes]).reshape(-1, 2)).query(to.x)
    element, node = np.divmod(near, len(l))

    vertices = slice(len(to.mesh.points))
    velocity = gathering(space.nodes[element], shapes[node], len(space.x))
    pressure = gathering(space.nodes[element[vertices], :3], l[node[vertices]], len(space.mesh.points))
    return clean(velocity), clean(pressure)


def advection(space: Space, velocity: np.ndarray) -> sp.csr_matrix:
    """Return N (n, n), ((U . grad) psi_k, psi_i) for a velocity U (n, 2) at the nodes."""
    U, V = (space.velocity.interpolate(component) for component in velocity.T)
    form = skfem.BilinearForm(lambda u, v, w: (w.U * u.grad[0] + w.V * u.grad[1]) * v)
    return sp.csr_matrix(form.assemble(space.velocity, U=U, V=V))
