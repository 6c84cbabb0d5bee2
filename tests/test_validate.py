"""The physics gate: every reference of `manywake validate` is met, and a wrong number would not be."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from manywake.case import task
from manywake.flow import baseline, problem, validate
from manywake.flow.validate import Check
from manywake.suite import cylinder_jets


def test_the_solver_meets_every_reference(shipped):
    mixing = task.matrix(cylinder_jets.TASK, 2)[:, 0]
    kept = Path(cylinder_jets.__file__).with_suffix(".json")
    checks = validate.run(shipped, cylinder_jets.REFERENCES, mixing, kept)
    assert len(checks) == 43
    failed = {check.name: (check.ours, check.reference) for check in checks if not check.passed}
    assert not failed


@pytest.mark.parametrize(
    ("ours", "kind", "passed"),
    [
        (1.019, "relative", True),
        (1.021, "relative", False),
        (1.019, "absolute", True),
        (1.021, "absolute", False),
        (1.0, "at least", True),
        (0.99, "at least", False),
        (1.0, "at most", True),
        (1.01, "at most", False),
        (float("nan"), "relative", False),
        (9.0, "reported", True),
        (float("nan"), "at least", False),
    ],
)
def test_a_check_passes_within_its_tolerance_only(ours, kind, passed):
    assert Check("x", ours, 1.0, 0.02, kind, "").passed == passed


# ---- what is wrong is noticed


@pytest.fixture(scope="module")
def posed(shipped):
    return problem.pose(shipped.case, shipped.baseline.mesh)


def judged(flow, posed):
    """Return the checks of a flow that need no reference, by name, and which of them fail."""
    checks = [validate.viscosity(flow), *validate.fluxes(flow, posed), *validate.forces(flow)]
    return {check.name: check for check in checks}, {check.name for check in checks if not check.passed}


def changed(flow, **tables):
    """Return a flow with some tables of its time loop changed."""
    ops = replace(flow.operators, tables=flow.operators.tables._replace(**tables))
    return replace(flow, operators=ops)


def test_nothing_is_wrong_with_the_shipped_flow(shipped, posed):
    checks, failed = judged(shipped, posed)
    assert not failed
    assert checks["residual force off, old pressure forgotten"].ours < 0.01  # a fifth of its bound


def test_a_viscosity_half_a_percent_off_is_noticed(shipped, posed):
    off = replace(shipped.case, reynolds=shipped.case.reynolds / 1.005)
    wrong = replace(shipped, operators=baseline.assemble(off, posed, *shipped.baseline.advecting))
    assert judged(wrong, posed)[1] == {"viscosity of the time loop"}


def test_jets_two_percent_too_strong_are_noticed(shipped, posed):
    wrong = changed(shipped, input_profile=1.02 * shipped.operators.tables.input_profile)
    assert {"flux of cylinder.top at amplitude 1", "flux of cylinder.bottom at amplitude 1"} <= judged(wrong, posed)[1]


def test_exchanged_jets_are_noticed(shipped, posed):
    wrong = changed(shipped, input_profile=shipped.operators.tables.input_profile[::-1].copy())
    assert {"flux of cylinder.top at amplitude 1", "flux of cylinder.bottom at amplitude 1"} <= judged(wrong, posed)[1]


def test_a_force_without_the_thrust_of_the_jets_is_noticed(shipped, posed):
    wrong = changed(shipped, flux=np.zeros_like(shipped.operators.tables.flux))
    assert judged(wrong, posed)[1] == {"residual C_L, one input on"}


def test_a_force_made_with_the_old_pressure_is_noticed(shipped, posed):
    # without these rows the pressure of the force is p*; where the old one was forgotten, p* and p^n are both zero
    rows = shipped.operators.tables.read_pressure
    wrong = changed(shipped, read_pressure=rows._replace(value=np.zeros_like(rows.value)))
    checks, failed = judged(wrong, posed)
    assert failed == {"residual force off, old pressure forgotten"}
    assert checks["residual force off, old pressure forgotten"].ours > 0.5  # ten times its bound
