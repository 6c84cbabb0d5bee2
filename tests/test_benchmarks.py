"""The benchmarks run and say what they promise; their figures are measured elsewhere, never asserted."""

import json
import subprocess
import sys

import pytest

from benchmarks import scaling

pytestmark = pytest.mark.alone


def test_scaling_reports_speed_up_against_one_environment_and_no_time_is_gained_from_nothing(monkeypatch):
    monkeypatch.setattr(scaling, "SECONDS", 0.02)
    synced, unsynced = scaling.table([(1, False, 1), (2, False, 1), (3, True, 2)], 0.0, 0.0, 1)
    assert synced["1"]["speedup"] == pytest.approx(1.0)
    assert set(synced) == {"1", "2"} and set(unsynced) == {"3"}
    for case in [*synced.values(), *unsynced.values()]:
        assert case["measured_over_predicted"] >= 1.0
        assert case["overhead_ms_per_episode"] >= 0.0


def test_the_command_measures_a_step_at_every_width_asked_for():
    words = ["bench", "step", "--lanes", "1", "3", "--json"]
    done = subprocess.run([sys.executable, "-m", "manywake.cli", *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["dofs"] == found["velocity_dofs"] + found["pressure_dofs"]
    for width in ("1", "3"):
        least, most = found["spread_ms"][width]
        assert 0.0 < least <= found["ms_per_flow_step"][width] <= most
