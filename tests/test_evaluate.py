"""The figures of an evaluation against their definitions, and against flows that are known."""

import numpy as np
import pytest

from manywake.env.task import Task
from manywake.learn import evaluate
from manywake.learn.engine import Threads
from manywake.learn.policy import Policy
from manywake.learn.rollout import JetFlows


def constant(action: float) -> Policy:
    """A policy that always takes one action."""
    layers = ((np.zeros((1, 151), np.float32), np.array([action], np.float32)),)
    return Policy(0, np.zeros(151), np.ones(151), layers, np.zeros(1), np.ones(1))


def test_no_control_has_no_drag_reduction_and_the_known_lift(shipped):
    result = evaluate.play(JetFlows(*shipped, Task()), constant(0.0), [shipped[1].start], 28)
    steps = int(round(2 * shipped[1].shedding.period / shipped[0].case.time_step))
    control = evaluate.control(shipped[1], Task(), result.c_d[:steps, 0], result.c_l[:steps, 0], result.jets[:steps, 0])
    assert control.drag_reduction == pytest.approx(0.0, abs=2e-4)
    assert control.cl_rms == pytest.approx(shipped[1].shedding.cl_rms, rel=2e-3)
    assert control.jet_rms == 0.0


def test_the_steady_flow_has_all_the_shedding_drag_removed(shipped):
    base = shipped[1]
    steady = np.full(100, base.cd_steady)
    control = evaluate.control(base, Task(), steady, steady, steady)
    assert control.share_of_shedding_drag == pytest.approx(1.0)
    # 2.942 against 3.196; half a thousandth of either is a tenth of a point of their difference
    assert control.drag_reduction == pytest.approx(0.0795, abs=0.001)


def test_evaluation_windows_and_engine_do_not_change_the_numbers(shipped):
    task = Task(actions_per_episode=2)
    result = evaluate.evaluate(JetFlows(*shipped, task), constant(0.3), Threads(2))
    again = evaluate.evaluate(JetFlows(*shipped, task), constant(0.3), Threads(1))
    assert result.summary() == again.summary()
    assert len(result.phases) == evaluate.PHASES
    steps = task.steps(shipped[0].case.time_step)
    assert result.trajectory.c_d.shape == (4 * 2 * steps, evaluate.PHASES)
    np.testing.assert_allclose(result.episode.cd_controlled, result.trajectory.c_d[steps : 2 * steps, 0].mean())
    np.testing.assert_allclose(result.long_run.cl_mean, result.trajectory.c_l[4 * steps :, 0].mean())


def test_phases_are_an_eighth_of_a_period_apart(shipped):
    result = evaluate.play(JetFlows(*shipped, Task()), constant(0.0), [shipped[1].start], 14)
    from manywake.flow import baseline

    ops, base = shipped
    starts = baseline.phases(ops, base, 8)
    late = evaluate.play(JetFlows(*shipped, Task()), constant(0.0), [starts[2]], 1)
    shift = int(round(2 * base.shedding.period / shipped[0].case.time_step / 8))
    np.testing.assert_array_equal(late.c_l[:, 0], result.c_l[shift : shift + len(late.c_l), 0])
