"""The benchmarks run and say what they promise; their figures are measured elsewhere, never asserted."""

from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "benchmarks"


@pytest.fixture
def scaling(monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    import scaling

    monkeypatch.setattr(scaling, "SECONDS", 0.02)
    return scaling


def test_scaling_reports_speed_up_against_one_environment_and_no_time_is_gained_from_nothing(scaling):
    synced, unsynced = scaling.table([(1, False, 1), (2, False, 1), (3, True, 2)], 0.0, 0.0, 1)
    assert synced["1"]["speedup"] == pytest.approx(1.0)
    assert set(synced) == {"1", "2"} and set(unsynced) == {"3"}
    for case in [*synced.values(), *unsynced.values()]:
        assert case["measured_over_predicted"] >= 1.0
        assert case["overhead_ms_per_episode"] >= 0.0
