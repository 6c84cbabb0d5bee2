"""The uncontrolled flow: what it is told to be, from which starts, and what is made of it."""

import dataclasses

import numpy as np
import pytest

from manywake.case import BDF2, Box, NoSlip, Stream
from manywake.case import task as tasks
from manywake.case.case import Case, Scales
from manywake.env.control import ControlledFlows
from manywake.env.env import FlowEnv, FlowVectorEnv
from manywake.flow import baseline, exact, spinup, statistics, store
from manywake.flow.batch import FlowBatch
from manywake.flow.mesh import Mesh
from manywake.flow.spinup import FreeFlows
from manywake.suite.cylinder_jets import TASK

from .conftest import TINY, in_singles, tiny_mesh

SLOW = dataclasses.replace(TINY, reynolds=5, spin_up=40.0, scheme=BDF2, time_step=5e-4)
"""So viscous that nothing sheds."""


def test_every_kick_comes_with_its_mirror(tiny):
    starts = spinup.kicks(TINY, tiny)
    assert len(starts) == spinup.FLOWS
    for one, other in zip(starts[::2], starts[1::2], strict=True):
        np.testing.assert_array_equal(one.u, -other.u)
    assert len({abs(start.u).max() for start in starts}) == spinup.FLOWS // 2


def test_a_state_at_half_the_step_has_half_the_increments_and_is_itself_on_the_way_back(base):
    there = spinup.rescaled(base.start, 0.5)
    np.testing.assert_allclose(there.u - there.u_old, 0.5 * (base.start.u - base.start.u_old), atol=1e-15)
    back = spinup.rescaled(there, 2.0)
    for name, part in vars(base.start).items():
        np.testing.assert_allclose(getattr(back, name), part, atol=1e-12, err_msg=name)


def street(level, amplitude, steps=4000):
    t = np.arange(steps)
    lift = level + amplitude * np.sin(2 * np.pi * t / 331)
    return {"c_d": 3.0 + 0.03 * np.sin(4 * np.pi * t / 331), "c_l": lift}


def together(*records):
    return {name: np.stack([record[name] for record in records], axis=1) for name in records[0]}


def test_mirror_states_are_told_apart_and_phases_are_not():
    same = [street(0.0, 1.0), {name: np.roll(part, 100) for name, part in street(0.0, 1.0).items()}]
    assert spinup.apart(together(*same)) == [0]
    assert spinup.apart(together(street(0.3, 1.0), street(-0.3, 1.0), street(0.3, 1.0))) == [0, 1]


def test_flows_that_are_not_all_of_one_kind_are_aperiodic():
    assert spinup.kind(together(street(0.0, 1.0), street(0.1, 1.0)), "c_l") == "periodic"
    assert spinup.kind(together(street(0.0, 1.0), street(0.0, 0.0)), "c_l") == "aperiodic"


def test_a_flow_that_sheds_nothing_is_steady_and_can_be_controlled(tmp_path):
    made = baseline.make(SLOW, tiny_mesh(SLOW))
    assert made.statistics.kind == "steady" and made.statistics.period is None
    assert len(made.starts) == 1
    # stepping settles where Newton's method does
    for name in ("c_d", "c_l"):
        assert made.free[name] == pytest.approx(made.steady[name], rel=1e-2)
    assert 0.0 <= made.statistics["c_d"].error < 1e-5  # the spread of the flows that are side by side
    operators = in_singles(SLOW, made.mesh, *made.advecting)
    flows = ControlledFlows(store.Flow(SLOW, operators, made), dataclasses.replace(TASK, interval=0.025), 2)
    nothing, pushed = flows.act(np.array([[0.0], [1.0]])).reward
    assert nothing == pytest.approx(-0.5 * abs(made.free["c_l"]), abs=1e-4)
    assert abs(pushed - nothing) > 0.1
    path = tmp_path / "steady.npz"
    baseline.save(made, path)
    assert baseline.load(path, SLOW).digest() == made.digest()


@pytest.mark.parametrize(
    ("mean", "message"),
    [
        (40.0, "the flow blew up by time .* of its spin-up; halve the time step 0.00015"),
        (10.0, "the flow blew up by time .* of its spin-up about the mean; halve the time step 0.0006"),
    ],
)
def test_a_spin_up_that_blows_up_is_tried_at_half_the_step_and_then_says_so(mean, message):
    """The slower stream is spun up at a smaller step, and blows up at that of the case."""
    walls, inflow, outflow = TINY.conditions
    conditions = walls, dataclasses.replace(inflow, mean=mean), outflow
    wild = dataclasses.replace(TINY, reynolds=2, conditions=conditions, spin_up=40.0, time_step=6e-4)
    with pytest.raises(spinup.BlewUp, match=message):
        baseline.make(wild, tiny_mesh(wild))


def test_without_bodies_a_flow_is_judged_by_how_far_from_steady_it_is():
    box = Case(50, Box((0, 1), (0, 1)), (NoSlip("left", "right", "bottom"), Stream("top")), scales=Scales(1.0, 1.0))
    square = exact.square(3)
    sides = {"left": 0, "right": 1, "bottom": 2, "top": 3}
    mid = {name: edges(square, k) for name, k in sides.items()}
    case = dataclasses.replace(box, spin_up=40.0, time_step=0.005, scheme=BDF2)
    made = baseline.make(case, Mesh(square.points, square.triangles, mid))
    assert made.statistics.kind == "steady"
    assert made.free[spinup.UNSTEADINESS] < 1e-4


def edges(mesh, side):
    """Return the facets of one side of the unit square."""
    x, y = mesh.points.T
    on = np.flatnonzero([x == 0, x == 1, y == 0, y == 1][side])
    along = on[np.argsort((y if side < 2 else x)[on])]
    return np.stack([along[:-1], along[1:]], axis=1)


def test_the_seed_draws_the_start_and_nothing_else_does():
    batch = FlowVectorEnv(6, starts="any")
    first, _ = batch.reset(seed=3)
    assert len(np.unique(first, axis=0)) > 1
    for k in range(6):
        single, _ = FlowEnv(starts="any").reset(seed=3 + k)
        np.testing.assert_array_equal(single, first[k])
    starts = len(batch._flows.flows[0].starts)
    counts = np.bincount([tasks.begun(batch.task, seed, starts) for seed in range(64)], minlength=starts)
    assert counts.min() >= 6
    one, _ = FlowVectorEnv(6).reset(seed=3)
    assert len(np.unique(one, axis=0)) == 1


def test_start_states_are_a_quarter_of_a_period_apart(shipped, ops, base):
    assert len(base.starts) == 1 and len(shipped.starts) == baseline.PHASES
    np.testing.assert_array_equal(shipped.starts[0].u, base.start.u)
    flow, quarter = FlowBatch(ops, base.start, 1), round(base.statistics.period / ops.time_step / 4)
    for start in shipped.starts[1:]:
        spinup.free_run(flow, quarter)
        assert abs(flow.state(0).u - start.u).max() < 0.02 * abs(start.u).max()


def test_free_flows_name_the_reading_that_tells_periods(tiny):
    assert spinup.clock(TINY) == "c_l.cylinder"
    flows = FreeFlows(TINY, tiny, spinup.kicks(TINY, tiny)[:2], np.zeros((len(tiny.space.x), 2)))
    record = flows.advance(3)
    assert record["c_l.cylinder"].shape == (3, 2)
    assert statistics.kind({"c_l": np.zeros(100)}, "c_l") == "steady"
