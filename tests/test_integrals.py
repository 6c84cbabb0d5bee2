"""Sensors that are integrals: exact for fields that the elements hold, the same bits in every batch, and readings."""

import numpy as np
import pytest

from manywake.case import Circle, Energy, Outflow, Shear, Task, describe, door, replace
from manywake.case.case import readings as kinds
from manywake.case.sensors import RESERVED
from manywake.flow import archive, baseline, kernels, problem, readings
from manywake.flow.batch import FlowBatch, Start
from manywake.machine import simd

from .conftest import TINY, in_doubles, tiny_mesh
from .naive import energy

WALLS = (Shear("floor", "bottom"), Shear("ceiling", "top"), Shear("skin", "cylinder"), Shear("part", "cylinder.top"))
CASE = replace(
    TINY,
    scales=replace(TINY.scales, velocity=2.0),
    time_step=2.5e-4,
    sensors=(*TINY.sensors, *WALLS, Energy("energy")),
)
(X0, X1), (Y0, Y1) = TINY.domain.x, TINY.domain.y
SPEED = CASE.scales.velocity


def ops(still, precision=np.float32):
    """Return operators that measure the energy about `still`, (x, y) -> (u, v)."""
    posed = problem.pose(CASE, tiny_mesh(CASE))
    rest = np.stack(np.broadcast_arrays(*still(*posed.space.x.T)), axis=1).astype(float)
    return baseline.assemble(CASE, posed, None, still=rest, precision=precision)


def at(operators, velocity):
    """Return a state of a velocity, (x, y) -> (u, v)."""
    u = np.stack(np.broadcast_arrays(*velocity(*operators.space.x.T)), axis=1).astype(float)
    return Start(u, u, *np.zeros((3, len(operators.space.mesh.points))))


def read(operators, start, name):
    return float(FlowBatch(operators, start, 1).read(name)[0, 0])


@pytest.fixture(scope="module")
def sheared():
    """Operators, and a flow whose slopes are linear in x on all walls."""
    made = ops(lambda x, y: (0 * x, 0 * y))
    return made, at(made, lambda x, y: (y * (3 + x), 5 * x * y))


def test_shear_on_straight_walls_is_exact_and_positive_with_the_fluid_on_the_left(sheared):
    slope = (3 * (X1 - X0) + (X1**2 - X0**2) / 2) / SPEED
    assert read(*sheared, "floor") == pytest.approx(slope, rel=1e-12)
    assert read(*sheared, "ceiling") == pytest.approx(slope, rel=1e-12)  # slower towards the wall, against x


def test_shear_on_a_turning_body_is_that_of_rigid_rotation():
    made = ops(lambda x, y: (0 * x, 0 * y))
    turning = at(made, lambda x, y: (y, -x))  # clockwise: u_t = r, slope 1 over the whole circumference
    assert read(made, turning, "skin") == pytest.approx(2 * np.pi * 0.05 / SPEED, rel=2e-3)
    assert read(made, turning, "part") == pytest.approx(2 * np.pi * 0.05 / 36 / SPEED, rel=2e-3)


def test_energy_is_half_the_square_of_what_departs_from_the_steady_flow():
    made = ops(lambda x, y: (1.0 + 0 * x, x))
    start = at(made, lambda x, y: (3.0 + 0 * x, x - 1.0))
    area = float(made.space.velocity.dx.sum())
    assert read(made, start, "energy") == pytest.approx(0.5 * 5.0 * area, rel=1e-6)
    assert read(made, at(made, lambda x, y: (1.0 + 0 * x, x)), "energy") == 0.0


def test_energy_of_a_linear_departure_is_exact():
    made = ops(lambda x, y: (0 * x, 0 * y), np.float64)
    x, y = np.asarray(made.space.velocity.global_coordinates())
    wanted = 0.5 * float((((2 * x - y) ** 2 + (3 * y) ** 2) * made.space.velocity.dx).sum())
    assert read(made, at(made, lambda x, y: (2 * x - y, 3 * y)), "energy") == pytest.approx(wanted, rel=1e-12)


def test_what_a_step_reads_is_what_the_sensor_reads_after_it(sheared):
    made, start = sheared
    batch = FlowBatch(made, start, 3)
    amplitudes = np.full((4, 2, 3), [[0.0, 1e-3, -2e-3]])
    series = readings.named(made, batch.advance(amplitudes), amplitudes)
    assert list(series)[-5:] == ["floor", "ceiling", "skin", "part", "energy"]
    for name in ("floor", "ceiling", "skin", "part", "energy"):
        assert (series[name][-1] == batch.read(name)[:, 0]).all()
    assert series["energy"].min() > 0


def test_integrals_have_the_same_bits_in_every_batch(sheared):
    made, start = sheared
    names = [sensor.name for sensor in WALLS] + ["energy"]

    def run(flows):
        batch = FlowBatch(made, start, flows)
        amplitudes = np.tile(1e-3 * np.arange(flows), (3, 2, 1))
        series = readings.named(made, batch.advance(amplitudes), amplitudes)
        return np.stack([series[name] for name in names]), np.stack([batch.read(name) for name in names])

    series, now = run(21)
    for flows in (1, 2, 4, 8, 12):
        fewer, there = run(flows)
        assert (fewer == series[..., :flows]).all() and (there == now[:, :flows]).all()


@pytest.mark.parametrize("width", simd.WIDTHS)
def test_the_energy_of_a_kernel_is_that_of_its_slow_twin(width):
    random = np.random.default_rng(0)
    still, start = random.normal(size=(5, 2)), np.array([0, 2, 3, 5, 6, 7], np.uint32)
    column, value = np.array([0, 3, 1, 2, 4, 3, 4], np.uint32), random.normal(size=7)
    u, out = simd.zeros((5, 2), width), simd.zeros((2, 3), width)
    simd.numbers(u)[...] = random.normal(size=(5, 2, width))
    kernels.energy(still, start, column, value, simd.pairs(u), simd.zeros((5, 1), 2 * width), out, 1, 2)
    wanted = [energy(still, start, column, value, simd.numbers(u)[..., lane]) for lane in range(width)]
    np.testing.assert_allclose(simd.numbers(out)[1, 2], wanted, rtol=1e-13)


def test_integrals_survive_the_archive(sheared, tmp_path):
    made, start = sheared
    archive.save(made, tmp_path / "operators.npz")
    again = archive.load(tmp_path / "operators.npz", made.mesh)
    assert [read(again, start, name) for name in ("floor", "energy")] == [
        read(made, start, name) for name in ("floor", "energy")
    ]


def test_operators_without_a_steady_flow_refuse_its_energy():
    with pytest.raises(ValueError, match="still: got none"):
        in_doubles(CASE, tiny_mesh(CASE))


def test_integrals_are_readings_and_part_of_what_a_baseline_is_of():
    assert kinds(CASE)[-6:] == ("power", "floor", "ceiling", "skin", "part", "energy")
    assert describe.flow_digest(CASE) != describe.flow_digest(replace(CASE, sensors=()))
    assert describe.flow_digest(TINY) == describe.flow_digest(replace(TINY, sensors=()))


def test_a_reward_and_an_agent_may_ask_for_integrals():
    door.check(CASE, Task(0.025, 8, lambda now, free: free["energy"] - now["floor"], observe=("energy", "floor")))


@pytest.mark.parametrize(
    ("sensors", "message"),
    [
        ((Energy("a"), Energy("b")), "two of Energy"),
        ((Energy("work.a"),), "without a dot"),
        *(((Energy(name),), "a name for Energy that a reading may have") for name in RESERVED),
        ((Shear("a", "left"), Shear("b", "nowhere")), "got the wall 'nowhere'"),
        ((Shear("a", "right"),), "got the wall 'right'"),
    ],
)
def test_integrals_that_do_not_fit_are_refused(sensors, message):
    assert isinstance(TINY.conditions[-1], Outflow) and isinstance(TINY.bodies[0], Circle)
    with pytest.raises(ValueError, match=message):
        replace(TINY, sensors=sensors)
