"""The paper's scheme in legacy FEniCS (Debian's python3-dolfin), as an ordinary user writes it and tuned.

Run: /usr/bin/python3 benchmarks/peers/fenics.py as-written|tuned [--steps 60] [--statistics]

P2/P1 elements, incremental pressure correction after Goda (1979): Crank-Nicolson viscosity, forward Euler convection,

    (u* - u)/dt + (u . grad) u = div sigma((u + u*)/2, p),    lap p' = lap p + div u*/dt,    u' = u* - dt grad(p' - p).

as-written: the three matrices are assembled and factored once, the three right-hand sides are assembled anew in every
step with their boundary conditions, forces are forms written down at each call. So does the paper's released code,
which also finds the area of recirculation in every step; that is left out here.
tuned: the same equations, hence the same numbers; everything linear is a product with a matrix kept, only convection
is assembled, by kernels compiled with all optimisations; every matrix has the factorisation that suits it.
"""

import os
import sys

import shared  # first: it keeps the libraries to one thread

# isort: split
import dolfin as df
import numpy as np
from petsc4py import PETSc

NAMES = ("wall", "outlet", "inlet", "cylinder", "jet0", "jet1")
WALL, OUTLET, INLET, CYLINDER, JET0, JET1 = range(1, 7)
BODY = (CYLINDER, JET0, JET1)


class Problem:
    """Mesh, spaces, start state and probes, common to both ways of writing."""

    def __init__(self):
        df.set_log_level(df.LogLevel.ERROR)
        data = shared.load()
        self.mesh = triangulation(data["points"], data["triangles"])
        self.marks = facet_marks(self.mesh, data)
        self.ds = df.Measure("ds", domain=self.mesh, subdomain_data=self.marks)
        self.V = df.VectorFunctionSpace(self.mesh, "CG", 2)
        self.Q = df.FunctionSpace(self.mesh, "CG", 1)
        self.u, self.p = df.Function(self.V), df.Function(self.Q)
        # dofs of the two components in the order of shared.nodes
        where = self.V.tabulate_dof_coordinates()
        wanted = shared.nodes(data["points"], data["triangles"])
        self.dofs = []
        for c in range(2):
            mine = np.array(self.V.sub(c).dofmap().dofs())
            self.dofs.append(mine[shared.match(where[mine], wanted)])
            write(self.u, self.dofs[c], data["start_u"][:, c].astype(float))
        order = df.vertex_to_dof_map(self.Q)
        write(self.p, order, data["start_p"].astype(float))
        self.probe_dofs, self.probe_weights = probe_matrix(self.mesh, self.Q, data["probes"])

    def probes(self, pressure):
        return np.einsum("ij,ij->i", self.probe_weights, pressure[self.probe_dofs])


def triangulation(points, triangles):
    mesh, editor = df.Mesh(), df.MeshEditor()
    editor.open(mesh, "triangle", 2, 2)
    editor.init_vertices(len(points))
    editor.init_cells(len(triangles))
    for k, x in enumerate(points):
        editor.add_vertex(k, x)
    for k, vertices in enumerate(triangles):
        editor.add_cell(k, vertices.astype(np.uintp))
    editor.close()
    return mesh


def facet_marks(mesh, data):
    marks = df.MeshFunction("size_t", mesh, 1, 0)
    number = {tuple(sorted(facet.entities(0))): facet.index() for facet in df.facets(mesh)}
    for mark, name in enumerate(NAMES, start=1):
        for facet in data["boundary_" + name]:
            marks[number[tuple(sorted(facet))]] = mark
    return marks


def write(function, dofs, values):
    vector = function.vector().get_local()
    vector[dofs] = values
    function.vector().set_local(vector)
    function.vector().apply("insert")


def probe_matrix(mesh, Q, points):
    """Return dofs and weights, both (probes, 3), of the linear interpolation at the probes."""
    tree, vertices, cells = mesh.bounding_box_tree(), mesh.coordinates(), mesh.cells()
    dof = df.vertex_to_dof_map(Q)
    corners = cells[[tree.compute_first_entity_collision(df.Point(*x)) for x in points]]
    affine = np.concatenate([vertices[corners], np.ones((len(corners), 3, 1))], axis=2)
    right = np.concatenate([points, np.ones((len(points), 1))], axis=1)
    return dof[corners], np.linalg.solve(affine.transpose(0, 2, 1), right[:, :, None])[:, :, 0]


def sigma(u, p):
    return 2 * shared.VISCOSITY * df.sym(df.nabla_grad(u)) - p * df.Identity(2)


def inflow():
    return df.Expression(
        ("6*(x[1] - low)*(high - x[1])/pow(high - low, 2)", "0"), degree=2, low=shared.Y_LOW, high=shared.Y_HIGH
    )


def as_written(problem):
    """Return step(Q): one environment step as an ordinary user writes it."""
    V, Q, ds, marks = problem.V, problem.Q, problem.ds, problem.marks
    dt, mu = df.Constant(shared.TIME_STEP), df.Constant(shared.VISCOSITY)
    u, v, p, q = df.TrialFunction(V), df.TestFunction(V), df.TrialFunction(Q), df.TestFunction(Q)
    u_n, p_n, u_, p_ = problem.u, problem.p, df.Function(V), df.Function(Q)
    n = df.FacetNormal(problem.mesh)

    U = 0.5 * (u_n + u)
    F1 = (
        df.dot(u - u_n, v) / dt * df.dx
        + df.dot(df.dot(u_n, df.nabla_grad(u_n)), v) * df.dx
        + df.inner(sigma(U, p_n), df.sym(df.nabla_grad(v))) * df.dx
        + df.dot(p_n * n, v) * ds
        - df.dot(mu * df.nabla_grad(U) * n, v) * ds
    )
    grad = df.nabla_grad
    F2 = df.dot(grad(p), grad(q)) * df.dx - df.dot(grad(p_n), grad(q)) * df.dx + df.div(u_) * q / dt * df.dx
    F3 = df.dot(u, v) * df.dx - df.dot(u_, v) * df.dx + dt * df.dot(grad(p_ - p_n), v) * df.dx

    jets = [
        df.Expression(
            tuple(f"Q*size*cos(pi*(atan2(x[1], x[0]) - centre)/w)*x[{c}]" for c in range(2)),
            degree=1, Q=0.0, size=np.pi / (2 * np.radians(shared.JET_WIDTH) * shared.RADIUS**2),
            centre=np.radians(angle if angle <= 180 else angle - 360), w=np.radians(shared.JET_WIDTH),
        )
        for angle in shared.JET_ANGLES
    ]  # fmt: skip
    still = df.Constant((0, 0))
    bcs_u = [df.DirichletBC(V, still, marks, WALL), df.DirichletBC(V, still, marks, CYLINDER)]
    bcs_u += [df.DirichletBC(V, inflow(), marks, INLET)]
    bcs_u += [df.DirichletBC(V, jet, marks, mark) for jet, mark in zip(jets, (JET0, JET1))]  # noqa: B905
    bcs_p = [df.DirichletBC(Q, df.Constant(0), marks, OUTLET)]

    assemblers = [df.SystemAssembler(df.lhs(F), df.rhs(F), bcs) for F, bcs in ((F1, bcs_u), (F2, bcs_p), (F3, bcs_u))]
    matrices, vectors = [df.Matrix() for _ in range(3)], [df.Vector() for _ in range(3)]
    solvers = []
    for assembler, matrix in zip(assemblers, matrices):  # noqa: B905
        assembler.assemble(matrix)
        solvers.append(df.LUSolver(matrix))

    def force(c):
        traction = df.dot(sigma(u_n, p_n), n) - u_n * df.dot(u_n, n)
        return -shared.TO_COEFFICIENT * df.assemble(traction[c] * ds(BODY))

    def step(rate):
        jets[0].Q, jets[1].Q = rate, -rate
        for k, solution in enumerate((u_, p_, u_)):
            assemblers[k].assemble(vectors[k])
            solvers[k].solve(solution.vector(), vectors[k])
        u_n.assign(u_)
        p_n.assign(p_)
        return force(0), force(1), problem.probes(p_n.vector().get_local())

    return step


def tuned(problem):
    """Return step(Q): the same equations with all that is constant made once."""
    df.parameters["form_compiler"]["optimize"] = True
    df.parameters["form_compiler"]["cpp_optimize"] = True
    df.parameters["form_compiler"]["cpp_optimize_flags"] = "-O3 -march=native -ffast-math"
    V, Q, ds, marks = problem.V, problem.Q, problem.ds, problem.marks
    dt, mu = shared.TIME_STEP, shared.VISCOSITY
    u, v, p, q = df.TrialFunction(V), df.TestFunction(V), df.TrialFunction(Q), df.TestFunction(Q)
    n = df.FacetNormal(problem.mesh)
    u_n, p_n = problem.u, problem.p

    def matrix(form):
        return df.as_backend_type(df.assemble(form)).mat()

    mass = df.dot(u, v) * df.dx
    viscous = df.inner(2 * mu * df.sym(df.grad(u)), df.sym(df.grad(v))) * df.dx
    viscous -= df.dot(mu * df.nabla_grad(u) * n, v) * ds
    momentum = matrix((1 / dt) * mass + 0.5 * viscous)
    history = matrix((1 / dt) * mass - 0.5 * viscous)
    gradient = matrix(p * df.div(v) * df.dx - df.dot(p * n, v) * ds)
    divergence = matrix((-1 / dt) * df.div(u) * q * df.dx)
    laplace = matrix(df.dot(df.grad(p), df.grad(q)) * df.dx)
    convection = df.Form(df.dot(df.dot(u_n, df.nabla_grad(u_n)), v) * df.dx)

    # boundary values: steady ones, and of the pair of jets at Q, -Q
    still, steady, pair = df.Constant((0, 0)), df.Function(V), df.Function(V)
    bcs = [df.DirichletBC(V, still, marks, mark) for mark in (WALL, *BODY)]
    bcs += [df.DirichletBC(V, inflow(), marks, INLET)]
    for bc in bcs:
        bc.apply(steady.vector())
    fixed = np.unique(np.concatenate([list(bc.get_boundary_values()) for bc in bcs])).astype(np.int32)
    where = V.tabulate_dof_coordinates()
    for sign, mark, k in ((1, JET0, 0), (-1, JET1, 1)):
        dofs = np.array(list(df.DirichletBC(V, still, marks, mark).get_boundary_values()))
        profile = shared.jet_profiles(where[dofs])[k]
        second = np.isin(dofs, problem.dofs[1]).astype(int)
        write(pair, dofs, sign * profile[np.arange(len(dofs)), second])
    steady_values, pair_values = (f.vector().get_local()[fixed] for f in (steady, pair))

    # one component of the mass matrix serves both
    components = [np.array(V.sub(c).dofmap().dofs(), dtype=np.int32) for c in range(2)]
    rows = [PETSc.IS().createGeneral(component) for component in components]
    scalar_mass = matrix(mass).createSubMatrix(rows[0], rows[0])
    rise = matrix(-dt * df.dot(df.grad(p), v) * df.dx)
    rises = [rise.createSubMatrix(row) for row in rows]
    scalar_fixed = np.flatnonzero(np.isin(components[0], fixed)).astype(np.int32)
    outlet = np.array(list(df.DirichletBC(Q, df.Constant(0), marks, OUTLET).get_boundary_values()), dtype=np.int32)

    momentum.zeroRows(fixed, 1.0)
    scalar_mass.zeroRowsColumns(scalar_fixed, 1.0)
    laplace.zeroRowsColumns(outlet, 1.0)
    solve_u = direct(momentum, "lu", "umfpack")
    solve_p = direct(laplace, "cholesky", "cholmod")
    solve_mass = direct(scalar_mass, "cholesky", "petsc")

    # forces: linear in velocity and pressure, but for the jets' momentum, which is quadratic in Q
    forces_u, forces_p, thrust = [], [], []
    for c in range(2):
        for form, into in (
            (df.dot(2 * mu * df.sym(df.nabla_grad(u_n)), n)[c] * ds(BODY), forces_u),
            (-p_n * n[c] * ds(BODY), forces_p),
        ):
            into.append(-shared.TO_COEFFICIENT * df.assemble(df.derivative(form, u_n if into is forces_u else p_n)))
        thrust.append(shared.TO_COEFFICIENT * df.assemble(pair[c] * df.dot(pair, n) * ds(BODY)))
    forces_u, forces_p = np.array([f.get_local() for f in forces_u]), np.array([f.get_local() for f in forces_p])

    c_n = df.Vector()
    df.assemble(convection, tensor=c_n)
    C, un, pn = (df.as_backend_type(f).vec() for f in (c_n, u_n.vector(), p_n.vector()))
    b, b_p, dp, us = un.duplicate(), pn.duplicate(), pn.duplicate(), un.duplicate()
    b_m, du = scalar_mass.createVecs()

    def step(rate):
        df.assemble(convection, tensor=c_n)
        history.mult(un, b)
        gradient.multAdd(pn, b, b)
        b.axpy(-1.0, C)
        b.array_w[fixed] = steady_values + rate * pair_values
        solve_u.solve(b, us)
        divergence.mult(us, b_p)
        b_p.array_w[outlet] = 0.0
        solve_p.solve(b_p, dp)
        pn.axpy(1.0, dp)
        us.copy(un)
        velocity = un.array_w
        for component, part in zip(components, rises):  # noqa: B905
            part.mult(dp, b_m)
            b_m.array_w[scalar_fixed] = 0.0
            solve_mass.solve(b_m, du)
            velocity[component] += du.array_r
        pressure = pn.array_r
        c_d, c_l = forces_u @ velocity + forces_p @ pressure + np.array(thrust) * rate**2
        return c_d, c_l, problem.probes(pressure)

    return step


def direct(matrix, kind, package):
    """Return a solver that keeps the factors of a matrix."""
    if kind == "cholesky":
        matrix.setOption(PETSc.Mat.Option.SPD, True)
    solver = PETSc.KSP().create()
    solver.setOperators(matrix)
    solver.setType("preonly")
    preconditioner = solver.getPC()
    preconditioner.setType(kind)
    preconditioner.setFactorSolverType(package)
    if package == "petsc":
        preconditioner.setFactorOrdering("nd")
    solver.setUp()
    return solver


WAYS = {"as-written": as_written, "tuned": tuned}


def main():
    parser = shared.arguments(__doc__.splitlines()[0])
    parser.add_argument("way", choices=WAYS)
    options = parser.parse_args()
    problem = Problem()
    step = WAYS[options.way](problem)
    result = {
        "way": options.way,
        "version": df.__version__,
        "triangles": problem.mesh.num_cells(),
        "velocity_dofs": problem.V.dim(),
        "pressure_dofs": problem.Q.dim(),
    }
    if options.statistics:
        result["statistics"] = shared.statistics(step, options.statistics, options.transient)
    else:
        result |= shared.simulate(step, options.steps, options.warm)
    shared.finish(result | {"python": sys.version.split()[0], "threads": os.environ["OMP_NUM_THREADS"]})


if __name__ == "__main__":
    main()
