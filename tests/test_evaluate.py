"""The figures of an evaluation against their definitions, and against flows that are known."""

import numpy as np
import pytest

from manywake.flow import baseline, store
from manywake.learn import controllers, evaluate
from manywake.learn.controllers import Learnt
from manywake.learn.engine import Threads
from manywake.learn.evaluate import Trajectory
from manywake.learn.flows import Flows
from manywake.learn.policy import Policy
from manywake.suite import load
from manywake.suite.cylinder_jets import CASE, TASK

LIMITS = np.array([actuator.limit for actuator in CASE.actuators])


def constant(action: float) -> Policy:
    """A policy that always takes one action."""
    layers = ((np.zeros((1, 151), np.float32), np.array([action], np.float32)),)
    return Policy(0, np.zeros(151), np.ones(151), layers, np.zeros(1), np.ones(1))


def still(flow, start, actions) -> Trajectory:
    """A flow under a policy that leaves it alone."""
    return evaluate.play(flow, TASK, Learnt(constant(0.0)), [start], actions)


def test_no_control_has_no_drag_reduction_and_the_known_lift(shipped):
    base = shipped.baseline
    result = still(shipped, base.start, 28)
    steps = int(round(2 * base.statistics.period / CASE.dt))
    control = evaluate.control(base, LIMITS, evaluate.window(result, 0, steps), 0)
    assert control.drag_reduction == pytest.approx(0.0, abs=2e-4)
    assert control.cl_rms == pytest.approx(base.statistics["c_l"].rms, rel=2e-3)
    assert control.cl_std**2 == pytest.approx(control.cl_rms**2 - control.cl_mean**2)
    assert control.amplitude_rms == 0.0
    assert control.power == 0.0


def test_the_steady_flow_has_all_the_shedding_drag_removed(shipped):
    steady = np.full((100, 1), shipped.baseline.steady["c_d"])
    series = {"c_d": steady, "c_l": steady, "power": steady}
    part = Trajectory(series, np.zeros((100, 2, 1)), np.zeros((4, 1)), [])
    control = evaluate.control(shipped.baseline, LIMITS, part, 0)
    assert control.share_of_shedding_drag == pytest.approx(1.0)
    # 2.942 against 3.196; half a thousandth of either is a tenth of a point of their difference
    assert control.drag_reduction == pytest.approx(0.0795, abs=0.001)
    assert control.net_reduction == pytest.approx(control.drag_reduction - control.power / control.cd_uncontrolled)


def test_a_flow_without_bodies_is_judged_by_what_it_measures():
    chosen = load.choose("step", actions=2)
    flow = store.flow(chosen.case)
    part = evaluate.play(flow, chosen.task, controllers.simple("none", (), 1), [flow.baseline.start], 2)
    found = evaluate.control(flow.baseline, np.array([0.1]), part, 0)
    assert set(found.measured) == {"gauge", "energy"}
    assert found.measured["energy"] == pytest.approx(part.series["energy"].mean())
    assert found.reward == pytest.approx(1 - found.measured["energy"] / flow.baseline.free["energy"])


def test_evaluation_windows_and_engine_do_not_change_the_numbers(shipped):
    flows = Flows((shipped,), load.choose("cylinder-jets", actions=2))
    result = flows.evaluate(constant(0.3), Threads(2))
    again = flows.evaluate(constant(0.3), Threads(1))
    assert result.summary() == again.summary()
    assert len(result.phases) == evaluate.PHASES
    steps, series = flows.task.steps(CASE.dt), result.trajectory.series
    assert series["c_d"].shape == (4 * 2 * steps, evaluate.PHASES)
    np.testing.assert_allclose(result.episode.cd_controlled, series["c_d"][steps : 2 * steps, 0].mean())
    np.testing.assert_allclose(result.long_run.cl_mean, series["c_l"][4 * steps :, 0].mean())
    np.testing.assert_allclose(result.episode.reward, result.trajectory.rewards[1, 0])
    np.testing.assert_allclose(result.long_run.reward, result.trajectory.rewards[4:, 0].mean())


def test_phases_are_an_eighth_of_a_period_apart(shipped):
    base = shipped.baseline
    whole = still(shipped, base.start, 14).series["c_l"][:, 0]
    starts = baseline.phases(shipped.operators, base, 8, CASE.convective_time)
    late = still(shipped, starts[2], 1).series["c_l"][:, 0]
    shift = int(round(2 * base.statistics.period / CASE.dt / 8))
    np.testing.assert_array_equal(late, whole[shift : shift + len(late)])
