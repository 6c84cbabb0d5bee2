"""The paper's scheme as a careful Python user writes it with scikit-fem and SciPy, for one flow.

Run: python benchmarks/peers/scikit.py [--steps 60] [--statistics]

The equations of fenics.py, term by term, hence the same numbers. Matrices and SuperLU factors are made once, the nodes
on Dirichlet boundaries are taken out of them, one scalar factor of the mass serves both components, and convection is
a few matrix products over all elements at once.
"""

import os
import sys

import shared  # first: it keeps the libraries to one thread

# isort: split
import numpy as np
import scipy
import scipy.sparse as sp
import skfem
from scipy.sparse.linalg import splu
from skfem.helpers import div, dot, grad, sym_grad

BODY = ("cylinder", "jet0", "jet1")


def factor(matrix):
    """Factor a matrix of symmetric structure and strong diagonal; SuperLU's default order has thrice the entries."""
    options = {"SymmetricMode": True}
    return splu(sp.csc_matrix(matrix), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)


class Problem:
    """Bases, start state and step."""

    def __init__(self):
        data = shared.load()
        points, triangles = data["points"], data["triangles"].astype(np.int64)
        self.mesh = skfem.MeshTri(points.T.copy(), triangles.T.copy())
        known = {tuple(facet): k for k, facet in enumerate(np.sort(self.mesh.facets.T, axis=1).tolist())}
        facets = {
            key.removeprefix("boundary_"): np.array([known[tuple(sorted(f))] for f in data[key].tolist()])
            for key in data
            if key.startswith("boundary_")
        }
        dt, mu = shared.TIME_STEP, shared.VISCOSITY
        V = skfem.Basis(self.mesh, skfem.ElementVector(skfem.ElementTriP2()), intorder=4)
        Q = V.with_element(skfem.ElementTriP1())
        scalar = V.with_element(skfem.ElementTriP2())
        outside = skfem.FacetBasis(self.mesh, V.elem, intorder=4)
        body = skfem.FacetBasis(self.mesh, V.elem, facets=np.concatenate([facets[name] for name in BODY]), intorder=4)

        # inside, velocities are (2, n) in scikit-fem's order of the scalar space: vertices, then edges
        xs = scalar.doflocs.T
        vector = np.concatenate([np.concatenate([V.nodal_dofs[c], V.facet_dofs[c]]) for c in range(2)])
        n = scalar.N

        def matrix(form, trial, test):
            return sp.csr_matrix(skfem.asm(form, trial, test))

        mass = matrix(skfem.BilinearForm(lambda u, v, w: dot(u, v)), V, V)[vector][:, vector]
        viscous = matrix(skfem.BilinearForm(lambda u, v, w: 2 * mu * _inner(sym_grad(u), sym_grad(v))), V, V)
        viscous -= matrix(skfem.BilinearForm(lambda u, v, w: mu * dot(_transposed_grad(u, w.n), v)), outside, outside)
        viscous = viscous[vector][:, vector]
        gradient = matrix(skfem.BilinearForm(lambda p, v, w: p * div(v)), Q, V)
        q_outside = outside.with_element(skfem.ElementTriP1())
        gradient -= matrix(skfem.BilinearForm(lambda p, v, w: p * dot(w.n, v)), q_outside, outside)
        rise = matrix(skfem.BilinearForm(lambda p, v, w: -dt * dot(grad(p), v)), Q, V)
        divergence = matrix(skfem.BilinearForm(lambda u, q, w: -div(u) * q / dt), V, Q)
        laplace = matrix(skfem.BilinearForm(lambda p, q, w: dot(grad(p), grad(q))), Q, Q)
        momentum, history = sp.csr_matrix(mass / dt + 0.5 * viscous), sp.csr_matrix(mass / dt - 0.5 * viscous)

        # Dirichlet nodes and their values
        names = ("wall", "cylinder", "jet0", "jet1", "inlet")
        at = {name: np.unique(scalar.get_dofs(facets[name]).all()) for name in facets}
        fixed = np.unique(np.concatenate([at[name] for name in names]))
        steady, pair = np.zeros((2, n)), np.zeros((2, n))
        profiles = shared.jet_profiles(xs)
        pair[:, at["jet0"]] = profiles[0, at["jet0"]].T
        pair[:, at["jet1"]] = -profiles[1, at["jet1"]].T
        steady[0, at["inlet"]] = shared.inflow(xs[at["inlet"], 1])
        free = np.setdiff1d(np.arange(n), fixed)
        both = np.concatenate([free, n + free])
        p_free = np.setdiff1d(np.arange(Q.N), np.unique(Q.get_dofs(facets["outlet"]).all()))
        solve_u = factor(momentum[both][:, both]).solve
        solve_p = factor(laplace[p_free][:, p_free]).solve
        solve_mass = factor(mass[free][:, free]).solve
        lift, pair_lift = (momentum[both] @ x.ravel() for x in (steady, pair))
        history = history[both]
        gradient, rise = gradient[vector][both], rise[vector][both]
        divergence = divergence[:, vector][p_free]

        # convection: gather on elements, products with the tables of the reference triangle, scatter by a matrix;
        # elements come last, so that NumPy's inner loops are long, and memory is taken once
        quadrature = skfem.CellBasis(self.mesh, skfem.ElementTriP2(), intorder=5)
        nodes = np.ascontiguousarray(quadrature.element_dofs)  # (6, e)
        value, slope = reference_tables(quadrature.X)  # (q, 6), (2, q, 6)
        q, elements = len(value), nodes.shape[1]
        tables = np.concatenate([value, *slope])  # (3 q, 6)
        scatter = sp.csr_matrix((np.ones(nodes.size), (nodes.ravel(), np.arange(nodes.size))), (n, nodes.size))[free]
        # inverse Jacobian times quadrature weight, (2, 2, q, e)
        inverse = quadrature.mapping.invDF(quadrature.X).transpose(0, 1, 3, 2) * quadrature.dx.T
        inverse, value = np.ascontiguousarray(inverse), np.ascontiguousarray(value.T)
        tested = np.empty((2, 6, elements))
        at_q = np.empty((2, 3, q, elements))
        along, a, b, extra = (np.empty((q, elements)) for _ in range(4))

        def convection(u):
            for c in range(2):
                np.matmul(tables, np.take(u[c], nodes), out=at_q[c].reshape(3 * q, elements))
            # (u . grad) on the reference triangle: a d/dX + b d/dY
            for k, out in enumerate((a, b)):
                np.multiply(inverse[k, 0], at_q[0, 0], out=out)
                np.multiply(inverse[k, 1], at_q[1, 0], out=extra)
                np.add(out, extra, out=out)
            for c in range(2):
                np.multiply(a, at_q[c, 1], out=along)
                np.multiply(b, at_q[c, 2], out=extra)
                np.add(along, extra, out=along)
                np.matmul(value, along, out=tested[c])
            return np.concatenate([scatter @ tested[c].ravel() for c in range(2)])

        # forces: linear in u and p, and the jets' momentum, quadratic in Q
        scale = -shared.TO_COEFFICIENT
        zero = np.zeros(2)
        force_u, force_p, thrust = [], [], []
        pair_full = np.zeros(V.N)
        pair_full[vector] = pair.ravel()
        jet = body.interpolate(pair_full)
        for c in range(2):
            direction = zero.copy()
            direction[c] = 1.0

            def traction(v, w, direction=direction):
                return 2 * mu * np.einsum("ij...,i...,j->...", sym_grad(v), w.n, direction)

            force_u.append(scale * skfem.asm(skfem.LinearForm(traction), body)[vector])
            q_body = body.with_element(skfem.ElementTriP1())
            force_p.append(scale * skfem.asm(skfem.LinearForm(lambda v, w, c=c: -v * w.n[c]), q_body))
            thrust.append(-scale * np.sum(jet.value[c] * dot(jet.value, body.normals) * body.dx))
        force_u, force_p, thrust = np.array(force_u), np.array(force_p), np.array(thrust)

        probes = sp.csr_matrix(Q.probes(data["probes"].T))
        place = shared.match(shared.nodes(points, triangles), xs)
        self.u = data["start_u"].astype(float)[place].T.copy()
        self.p = data["start_p"].astype(float)
        self.u[:, fixed] = steady[:, fixed]
        nf = len(free)
        dp = np.zeros(Q.N)

        def step(rate):
            u, p = self.u, self.p
            right = history @ u.ravel() + gradient @ p - convection(u) - lift - rate * pair_lift
            new = steady + rate * pair
            new[:, free] = solve_u(right).reshape(2, nf)
            dp[p_free] = solve_p(divergence @ new.ravel())
            # two columns at once, as SuperLU likes them
            new[:, free] += solve_mass((rise @ dp).reshape(2, nf).T).T
            self.u, self.p = new, p + dp
            c_d, c_l = force_u @ new.ravel() + force_p @ self.p + thrust * rate**2
            return c_d, c_l, probes @ self.p

        self.step = step


def reference_tables(x):
    """Return values (q, 6) and slopes (2, q, 6) of scikit-fem's quadratic functions at points x (2, q)."""
    element = skfem.ElementTriP2()
    parts = [element.lbasis(x, k) for k in range(6)]
    return np.stack([f for f, _ in parts], axis=1), np.stack([g for _, g in parts], axis=2)


def _inner(a, b):
    return np.einsum("ij...,ij...->...", a, b)


def _transposed_grad(u, n):
    """Return nabla_grad(u) n, the vector of n_j du_j/dx_i: the released code's term at the outlet."""
    return np.einsum("ji...,j...->i...", grad(u), n)


def main():
    options = shared.arguments(__doc__.splitlines()[0]).parse_args()
    problem = Problem()
    result = {
        "version": skfem.__version__,
        "scipy": scipy.__version__,
        "triangles": problem.mesh.t.shape[1],
        "velocity_dofs": problem.u.size,
        "pressure_dofs": problem.p.size,
    }
    if options.statistics:
        result["statistics"] = shared.statistics(problem.step, options.statistics, options.transient)
    else:
        result |= shared.simulate(problem.step, options.steps, options.warm)
    shared.finish(result | {"python": sys.version.split()[0], "threads": os.environ["OMP_NUM_THREADS"]})


if __name__ == "__main__":
    main()
