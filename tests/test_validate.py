"""The physics gate: every reference of `manywake validate` is met, and a wrong number would not be."""

from pathlib import Path

import pytest

from manywake.case import task
from manywake.flow import validate
from manywake.flow.validate import Check
from manywake.suite import cylinder_jets


def test_the_solver_meets_every_reference(shipped):
    mixing = task.matrix(cylinder_jets.TASK, 2)[:, 0]
    kept = Path(cylinder_jets.__file__).with_suffix(".json")
    checks = validate.run(shipped, cylinder_jets.REFERENCES, mixing, kept)
    assert len(checks) == 25
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
        (float("nan"), "at least", False),
    ],
)
def test_a_check_passes_within_its_tolerance_only(ours, kind, passed):
    assert Check("x", ours, 1.0, 0.02, kind, "").passed == passed
