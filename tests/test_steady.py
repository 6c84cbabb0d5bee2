"""The steady flow: exact solutions at their rates, the paper's channel at Reynolds numbers of the door, and its end."""

from dataclasses import replace

import numpy as np
import pytest
import skfem

from manywake.case import Box, Case, Stream
from manywake.flow import mesh as meshes
from manywake.flow import problem, steady
from manywake.flow.mesh import Mesh

from .conftest import TINY, tiny_mesh

STEADY_DRAG = {40: 4.03, 60: 3.4556, 100: 2.9415, 150: 2.6590, 200: 2.5067, 250: 2.4030} | {
    300: 2.3189,
    350: 2.2481,
    400: 2.1899,
}
"""Of the channel, by Newton's method on 15 to 36 thousand triangles; from 300 on the half channel's less 0.001."""


def rectangle(level: int) -> Mesh:
    """Return the box of Kovasznay's flow in triangles, `level` times cut into four, with its sides by name."""
    mesh = skfem.MeshTri.init_tensor(np.linspace(-0.5, 1.0, 4), np.linspace(-0.5, 0.5, 3)).refined(level)
    sides = {"left": (0, -0.5), "right": (0, 1.0), "bottom": (1, -0.5), "top": (1, 0.5)}
    facets = {
        name: mesh.facets_satisfying(lambda x, c=c, at=at: abs(x[c] - at) < 1e-9) for name, (c, at) in sides.items()
    }
    named = {name: mesh.facets[:, of].T.astype(np.int64) for name, of in facets.items()}
    return Mesh(mesh.p.T.copy(), mesh.t.T.astype(np.int64), named)


BOX = Case(
    reynolds=40,
    domain=Box(x=(-0.5, 1.0), y=(-0.5, 0.5)),
    conditions=(Stream("left", "right", "bottom", "top"),),
)
"""Kovasznay's flow behind a grid, whose boundary values the tests put in the place of the stream's."""
DECAY = 20 - np.sqrt(400 + 4 * np.pi**2)


def kovasznay(x, y):
    """Return u, v and p: an exact solution of the steady equations at Re 40."""
    wave = np.exp(DECAY * x)
    u = 1 - wave * np.cos(2 * np.pi * y)
    return u, DECAY / (2 * np.pi) * wave * np.sin(2 * np.pi * y), -0.5 * wave**2


def error(level: int) -> tuple[float, float]:
    """Return the L2 errors of velocity and pressure (up to a constant)."""
    posed = problem.pose(BOX, rectangle(level))
    exact = np.zeros_like(posed.space.x)
    exact[posed.fixed] = np.stack(kovasznay(*posed.space.x[posed.fixed].T)[:2], axis=1)
    found = steady.solve(BOX, replace(posed, steady=exact))
    fine = skfem.Basis(posed.space.velocity.mesh, skfem.ElementTriP2(), intorder=8)
    u, v, p = kovasznay(*np.asarray(fine.global_coordinates()))
    du, dv = (np.asarray(fine.interpolate(part)) - wanted for part, wanted in zip(found.u.T, (u, v), strict=True))
    dp = np.asarray(fine.with_element(skfem.ElementTriP1()).interpolate(found.p)) - p
    dp = dp - np.sum(dp * fine.dx) / np.sum(fine.dx)
    return float(np.sqrt(np.sum((du**2 + dv**2) * fine.dx))), float(np.sqrt(np.sum(dp**2 * fine.dx)))


def test_kovasznay_s_flow_converges_with_rates_3_and_2():
    (u0, p0), (u1, p1) = error(2), error(3)
    assert np.log2(u0 / u1) > 2.8
    assert np.log2(p0 / p1) > 1.8
    assert u1 < 1e-3


def drag_of_the_channel(flow, reynolds: float) -> float:
    """Return the steady drag on the mesh of a flow at another Reynolds number."""
    posed = problem.pose(flow.case, flow.baseline.mesh)
    return steady.solve(replace(flow.case, reynolds=reynolds), posed).readings["c_d"]


def test_the_channel_has_its_steady_drag_at_re_200(shipped):
    assert drag_of_the_channel(shipped, 200) == pytest.approx(STEADY_DRAG[200], rel=5e-3)


def test_the_default_case_has_the_steady_flow_that_was_kept(shipped):
    found = steady.solve(shipped.case, problem.pose(shipped.case, shipped.baseline.mesh))
    for name, value in found.readings.items():
        assert value == pytest.approx(shipped.baseline.steady[name], rel=1e-9)


def test_drag_of_a_slow_flow_is_that_of_the_stokes_flow():
    posed = problem.pose(TINY, tiny_mesh())
    slow, slower = (steady.solve(replace(TINY, reynolds=re), posed).readings["c_d"] * re for re in (1e-3, 1e-4))
    assert slow == pytest.approx(slower, rel=1e-3)


def test_progress_grows_to_the_end():
    reported = []
    steady.solve(replace(TINY, reynolds=100), problem.pose(TINY, tiny_mesh()), lambda *both: reported.append(both))
    shares = [share for _, share in reported]
    assert {what for what, _ in reported} == {"steady flow"}
    assert shares == sorted(shares) and shares[-1] == 1.0


def test_a_flow_that_is_not_found_says_how_far_newton_came():
    posed = problem.pose(TINY, tiny_mesh())
    with pytest.raises(
        RuntimeError, match=r"came to Re 15\d\.\d, .* to Re 1\d\d\.\d, wanted Re 180; make .* \(sizes\)"
    ):
        steady.solve(replace(TINY, reynolds=180), posed)


def test_the_jacobian_is_the_derivative_of_the_residual_where_fluid_comes_back_in():
    equations, rng = steady._Equations(TINY, problem.pose(TINY, tiny_mesh())), np.random.default_rng(0)
    x, step = equations.boundary.copy(), np.zeros_like(equations.boundary)
    x[equations.free] = rng.normal(size=len(equations.free))
    step[equations.free] = rng.normal(size=len(equations.free))
    assert (equations.open.field(equations.velocity(x))[2] < 0.0).any()
    (right, _), (left, _) = (equations.residual(x + h * step, 3.0) for h in (1e-6, -1e-6))
    jacobian = equations.jacobian(x, equations.residual(x, 3.0)[1])
    difference = (right - left)[equations.free] / 2e-6
    error = abs(jacobian @ step[equations.free] - difference).max()
    assert error < 1e-7 * abs(difference).max()  # measured 2e-9; the residual is quadratic but where the flow turns


def test_a_flow_carried_to_a_finer_mesh_and_back_is_the_same():
    mesh = tiny_mesh()
    coarse = steady._Equations(TINY, problem.pose(TINY, mesh))
    fine = steady._Equations(TINY, problem.pose(TINY, meshes.refine(mesh)))
    x = coarse.stokes(0.0)
    np.testing.assert_allclose(fine.moved(coarse.moved(x, fine), coarse), x, atol=1e-12)
