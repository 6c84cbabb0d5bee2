"""References of every kind: what they measure, that they share runs, and that what a case does not have is refused."""

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.sparse.linalg import eigs

from manywake.case import Driven, Extremum, Growth, Length, Response, Settled, Statistic, Steady, replace
from manywake.case import references as said
from manywake.case.geometry import Side
from manywake.flow import baseline, exact, probe, reference, space, steady, store, validate
from manywake.flow.probe import Field
from manywake.flow.reference import Runs

from .conftest import TINY, tiny_mesh

SLOW = replace(TINY, reynolds=5.0, spin_up=40.0)
"""So viscous that nothing sheds."""
OURS = "ours"


@pytest.fixture(scope="module")
def slow(tmp_path_factory):
    """The flow of SLOW, kept in a cache of its own, where other Reynolds numbers find its mesh."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        baseline.save(baseline.make(SLOW, tiny_mesh(SLOW)), store.cache_path(SLOW))
        yield store.flow(SLOW)


@pytest.fixture
def runs(slow):
    return Runs(slow, lambda what, share: None)


# ---- along lines


def field(of):
    """Return a velocity, of(x, y) -> (u, v) of second degree, on the unit square."""
    unit = space.build(exact.square(2))
    return Field(unit, np.stack(np.broadcast_arrays(*of(*unit.x.T)), axis=1).astype(float))


BOTTOM, TOP = Side("bottom", (0.0, 0.0), (1.0, 0.0)), Side("top", (1.0, 1.0), (0.0, 1.0))
POINTS = np.random.default_rng(0).uniform(0.05, 0.95, (20, 2))


def test_velocity_and_gradient_of_a_field_of_second_degree_are_exact():
    x, y = POINTS.T
    found = field(lambda x, y: (x**2 + 3 * x * y, y - 2 * y**2 + x))
    np.testing.assert_allclose(found.velocity(POINTS), np.stack([x**2 + 3 * x * y, y - 2 * y**2 + x], axis=1))
    wanted = np.array([[2 * x + 3 * y, 3 * x], [np.ones_like(x), 1 - 4 * y]]).transpose(2, 0, 1)
    np.testing.assert_allclose(found.gradient(POINTS), wanted, atol=1e-10)


def test_an_extremum_on_a_line_is_that_of_its_parabola():
    found = field(lambda x, y: (1 - (y - 0.37) ** 2, 3 * (x - 0.61) ** 2 - 2))
    assert probe.extremum(found, (0.5, 0.0), (0.5, 1.0), 0, 1.0) == pytest.approx(1.0, abs=1e-10)
    assert probe.extremum(found, (0.0, 0.2), (1.0, 0.2), 1, -1.0) == pytest.approx(-2.0, abs=1e-10)
    assert probe.extremum(found, (0.0, 0.2), (1.0, 0.2), 1, 1.0) == pytest.approx(3 * 0.61**2 - 2, abs=1e-6)


def test_shear_changes_its_sign_where_it_should_from_whichever_end():
    low, high = field(lambda x, y: (y * (x - 0.3), 0 * x)), field(lambda x, y: ((1 - y) * (x - 0.3), 0 * x))
    for found, side, y in ((low, BOTTOM, 0.0), (high, TOP, 1.0)):
        assert probe.changes(found, side, (0.0, y), (1.0, y)) == pytest.approx([0.3], abs=1e-6)
        assert probe.changes(found, side, (1.0, y), (0.0, y)) == pytest.approx([0.7], abs=1e-6)
        assert len(probe.changes(found, side, (0.4, y), (1.0, y))) == 0
    assert low.shear(BOTTOM, np.array([[0.8, 0.0]])) == pytest.approx(0.5)


# ---- flows


def test_a_flow_that_settles_and_its_steady_flow_agree_at_every_reynolds_number(runs):
    for reynolds in (None, 8.0):
        by_time = reference.number(runs, Statistic("", "c_d mean", 0, None, OURS, reynolds=reynolds))
        by_newton = reference.number(runs, Steady("", "c_d", 0, None, OURS, reynolds=reynolds))
        assert by_time == pytest.approx(by_newton, rel=1e-3)
    assert by_newton < reference.number(runs, Steady("", "c_d", 0, None, OURS))


def test_the_flow_at_another_reynolds_number_is_kept(slow, runs):
    number = Statistic("", "c_l amplitude", 0, None, OURS, reynolds=8.0)
    first = reference.number(runs, number)
    assert first == pytest.approx(0.0, abs=1e-3)
    told = []
    again = reference.number(Runs(slow, lambda what, share: told.append(what)), number)
    assert again == first
    assert {what for what in told if "spin-up" in what} == set()
    assert store.cache_path(replace(SLOW, reynolds=8.0, actuators=(), sensors=())).exists()


def test_another_time_step_is_that_of_the_flow_that_is_made(runs):
    number = Statistic("", "c_d mean", 0, None, OURS, time_step=2.5e-4)
    whole = reference.number(runs, replace(number, time_step=None))
    assert reference.number(runs, number) == pytest.approx(whole, rel=1e-3)
    assert store.cache_path(replace(SLOW, time_step=2.5e-4, actuators=(), sensors=())).exists()


def test_without_control_a_response_is_the_uncontrolled_flow(runs):
    held = Response("", "c_d mean", 0, None, OURS, (0.0, 0.0), settle=4.0, duration=8.0)
    assert reference.number(runs, held) == pytest.approx(runs.statistics(None, None)["c_d"].mean, rel=1e-3)


def test_a_response_may_exceed_the_limit_and_its_mirror_image_has_the_opposite_lift(runs):
    up, down = (
        reference.number(runs, Response("", "c_l mean", 0, None, OURS, held, settle=20.0, duration=24.0))
        for held in ((0.02, -0.02), (-0.02, 0.02))
    )
    assert SLOW.actuators[0].limit < 0.02
    still = reference.number(runs, Steady("", "c_l", 0, None, OURS))  # the channel is no mirror image of itself
    assert abs(up - down) > 1
    assert up - still == pytest.approx(-(down - still), rel=0.25)


def test_a_wake_sheds_and_a_slow_flow_does_not(shipped, runs):
    long = Response("", "sheds", 1.0, None, OURS, (0.0, 0.0), settle=1.0, duration=41.0)
    (check,) = reference.checks(Runs(shipped, lambda what, share: None), long)
    assert check.ours == 1.0 and check.passed
    (check,) = reference.checks(runs, long)
    assert check.ours == 0.0 and not check.passed
    assert reference.checks(runs, replace(long, value=0.0))[0].passed


def test_a_driven_flow_from_rest_runs_once_for_all_its_numbers_and_comes_to_the_steady_flow(runs):
    times = []

    def driving(t):
        times.append(t)
        return 0.0, 0.0

    drop = Driven("", "pressure drop", 0, None, OURS, driving, 3.0, points=((-0.15, 0.0), (0.3, 0.0)))
    largest, least = (replace(drop, of=of, points=None) for of in ("c_d max", "c_d min"))
    found = [reference.number(runs, number) for number in (drop, largest, least)]
    np.testing.assert_allclose(times, SLOW.dt * np.arange(1, len(times) + 1))
    assert len(times) == round(3.0 / SLOW.dt)
    still = runs.steady(None)
    p = [runs.posed.space.pressure.probes(np.array(x)[:, None]) @ still.p for x in drop.points]
    assert found[0] == pytest.approx((p[0] - p[1])[0], rel=1e-3)
    assert found[2] <= still.readings["c_d"] * 1.001 < found[1]


def test_a_number_without_tolerance_is_reported_and_passes(slow):
    checks = validate.run(slow, (Steady("drag", "c_d", 1e9, None, OURS),))
    assert checks[0].kind == "reported" and checks[0].passed
    assert checks[0].ours == pytest.approx(slow.baseline.steady["c_d"], rel=1e-6)


def test_a_length_that_there_is_not_is_no_number_and_fails(runs):
    (check,) = reference.checks(runs, Length("", (-0.2, -0.2), (0.5, -0.2), 5, 1.0, 0.01, OURS))
    assert np.isnan(check.ours) and not check.passed


def test_the_fastest_on_a_line_across_the_inlet_is_the_parabola_s(runs):
    number = Extremum("", "u max", (-0.1999, -0.2), (-0.1999, 0.21), 1.5, 0.01, OURS)
    assert reference.number(runs, number) == pytest.approx(1.5, rel=0.05)  # P2 on few facets of an inlet


# ---- what a flow makes of a small disturbance, and of its symmetry


def test_a_rate_of_growth_is_that_of_the_eigenvalue_furthest_to_the_right(runs):
    wanted = Growth("", "rate", 0, None, OURS, reynolds=30.0)
    still, equations = runs.steady(30.0), steady._Equations(replace(SLOW, reynolds=30.0), runs.posed)
    x, none = np.concatenate([*still.u.T, still.p]), sp.csr_matrix((equations.m, equations.m))
    jacobian = equations.jacobian(x, equations.residual(x, np.log(30.0))[1])
    mass = sp.block_diag([runs.posed.space.mass] * 2 + [none], format="csr")[equations.free][:, equations.free]
    nearest = eigs(-jacobian, k=20, M=mass, sigma=0.0, return_eigenvectors=False)  # the rightmost is among them
    rate = nearest.real.max() * SLOW.convective_time
    assert reference.number(runs, wanted) == pytest.approx(rate, rel=0.03)


def test_a_disturbance_that_decays_does_not_grow_and_one_that_grows_does(runs, monkeypatch):
    grows = Growth("", "grows", 0, 0.0, OURS)
    assert [check.passed for check in reference.checks(runs, grows)] == [True]
    for rate, passed in ((0.01, True), (-0.01, False), (np.nan, False)):
        monkeypatch.setattr(runs, "growth", lambda reynolds, time_step, rate=rate: rate)
        assert [check.passed for check in reference.checks(runs, replace(grows, value=1))] == [passed]


def record(*lifts):
    """Return a record of flows of these mean lifts, which oscillate by 1."""
    wave = np.sin(np.linspace(0, 20 * np.pi, 2001))[:-1, None]
    return {name: wave + np.array(lifts) for name in ("c_l", "c_l.cylinder")}


@pytest.mark.parametrize(("lifts", "wanted"), [((0.0, 0.0), 0.0), ((0.3, -0.3), 1.0), ((-0.3,), 1.0), ((0.01,), 0.0)])
def test_mirror_states_lift_though_their_lifts_cancel(runs, monkeypatch, lifts, wanted):
    monkeypatch.setattr(runs, "record", lambda reynolds, time_step: (record(*lifts), "aperiodic", 1.0))
    assert reference.number(runs, Statistic("", "lifts", 0, 0.0, OURS)) == wanted
    assert reference.number(runs, Statistic("", "c_l mean", 0, 0.0, OURS)) == pytest.approx(np.mean(lifts), abs=1e-9)
    assert [check.passed for check in reference.checks(runs, Statistic("", "lifts", 1, 0.0, OURS))] == [wanted == 1.0]


HELD = {"amplitudes": (0.0, 0.0), "settle": 1.0, "duration": 2.0}
WRONG = {
    "no reading": (Statistic("x", "c_d.square mean", 1, None, OURS), "wanted one of c_d mean"),
    "no kind": (Statistic("x", "c_d median", 1, None, OURS), "wanted one of c_d mean"),
    "no steady power": (Steady("x", "power", 1, None, OURS), "wanted one of c_d"),
    "no component": (Extremum("x", "w max", (0, 0), (1, 1), 1, None, OURS), "wanted one of u max"),
    "no wall": (Length("x", (0.0, 0.0), (0.3, 0.0), 0, 1, None, OURS), "wanted two points on one side"),
    "no growth of drag": (Growth("x", "c_d", 1, None, OURS), "wanted one of rate, grows"),
    "no held flow lifts": (Response("x", "lifts", 1, None, OURS, (0.0, 0.0), 1.0, 2.0), "wanted one of c_d mean"),
    "one amplitude": (Response("x", "c_d mean", 1, None, OURS, (0.0,), 1.0, 2.0), "wanted 2"),
    "too short": (Response("x", "sheds", 1, None, OURS, (0.0, 0.0), 1.0, 40.0), "and a duration above 41"),
    "no points": (Driven("x", "pressure drop", 1, None, OURS, lambda t: (0, 0), 1.0), "wanted two points"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_reference_to_what_a_case_does_not_have_is_refused(name):
    wrong, text = WRONG[name]
    with pytest.raises(ValueError, match=f"reference 'x': got .*{text}"):
        said.check(TINY, [wrong])


def test_all_that_a_case_has_is_taken():
    said.check(TINY, [Settled("x", 20.0, {"c_d": (1.0, 0.1)}, OURS), Statistic("x", "St", 1, None, OURS)])
    said.check(TINY, [Response("x", "power mean", 1, None, OURS, **HELD)])
