"""manywake doctor and --version: what is here is told as it is, and a solver that errs is noticed."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest

from manywake.cli import doctor
from manywake.machine import compile, simd

pytestmark = pytest.mark.alone


def manywake(*words: str, **changes: str) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "manywake.cli", *words]
    return subprocess.run(command, capture_output=True, text=True, check=False, env=os.environ | changes)


def test_the_version_is_the_installed_one():
    done = manywake("--version")
    assert done.returncode == 0, done.stderr
    assert done.stdout == f"manywake {metadata.version('manywake')}\n"


def test_doctor_tells_what_is_here_tests_the_solver_and_leaves_no_file(tmp_path):
    home, room = tmp_path / "home", tmp_path / "room"
    home.mkdir()
    room.mkdir()
    places = {"HOME": str(home), "XDG_CACHE_HOME": str(home / "cache"), "TMPDIR": str(room)}
    kernels = os.environ.get("NUMBA_CACHE_DIR") or compile._cache_folder()  # they need not be compiled anew
    done = manywake("doctor", "--json", NUMBA_CACHE_DIR=kernels, **places)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["passed"] is True and [check["passed"] for check in found["self-test"]] == [True, True]
    for name in ("numpy", "numba", "torch", "gymnasium"):
        assert found[name] == metadata.version(name)
    assert found["cores"] >= 1 and found["vector register [bits]"] in (128, 256, 512)
    assert found["flows side by side"] == simd.WIDTHS[0]
    assert (found["cache"], found["cache writable"]) == (str(home / "cache" / "manywake"), True)
    assert found["free here [GB]"] > 0
    assert {"extra gmsh", "extra ray", "extra onnx", "extra window"} <= set(found)
    assert not [path for path in (*home.rglob("*"), *room.rglob("*")) if path.is_file()]


def test_a_drag_that_is_not_the_baseline_s_is_noticed(shipped, base):
    assert doctor.drag(shipped).passed
    moments = base.statistics.readings["c_d"]
    readings = base.statistics.readings | {"c_d": replace(moments, mean=1.002 * moments.mean)}
    other = replace(shipped, baseline=replace(base, statistics=replace(base.statistics, readings=readings)))
    assert not doctor.drag(other).passed


def test_one_bit_that_differs_between_alone_and_among_others_is_noticed(shipped):
    alone, among = doctor.beside(shipped)
    assert alone.shape == among.shape and len(alone) == doctor.STEPS and np.ptp(alone, axis=0).any()
    assert doctor.same(alone, among).passed
    among[7, 0] = np.nextafter(among[7, 0], np.inf)
    found = doctor.same(alone, among)
    assert not found.passed and found.got == f"other bits in 1 of {doctor.STEPS} steps"


def test_a_failed_self_test_ends_with_status_1_and_says_what_to_do(monkeypatch, capfd):
    monkeypatch.setattr(doctor, "WITHIN", -1.0)
    assert doctor.Doctor(json=True).run() == 1
    out, err = capfd.readouterr()
    assert json.loads(out.splitlines()[-1])["passed"] is False
    assert "self-test: mean C_D of a shedding period: got 3.19" in err and doctor.REMEDY in err


def test_an_error_amid_the_self_test_is_a_finding(monkeypatch):
    monkeypatch.setattr(doctor.load, "DEFAULT", "no such flow")
    (found,) = doctor.self_test()
    assert not found.passed and found.got.startswith("ValueError: case: got 'no such flow'")


def test_a_folder_that_cannot_be_written_to_is_told(tmp_path):
    assert doctor.writable(tmp_path / "not" / "there")
    assert not (tmp_path / "not").exists()
    assert not doctor.writable(Path("/proc/nowhere"))


def test_a_package_that_is_missing_is_told_beside_the_one_that_is_not():
    assert doctor.found_of(["numpy", "no-such-package"]) == (
        f"numpy {metadata.version('numpy')}; no-such-package not found"
    )
