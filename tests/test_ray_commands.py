"""The commands of README and docs/cluster.md in their order, in one home that nothing of Ray was in before."""

import json
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from manywake.machine import compile

pytestmark = pytest.mark.alone

SHORT = ["--actions", "2", "--update-period", "2", "--episodes", "2", "--hidden", "8", "--workers", "2", "--json"]


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


@pytest.fixture
def home(tmp_path):
    """Return an environment whose home is empty but for the kernels."""
    kept = {"NUMBA_CACHE_DIR": os.environ.get("NUMBA_CACHE_DIR") or compile._cache_folder()}
    rest = {name: value for name, value in os.environ.items() if not name.startswith("RAY_")}
    return rest | kept | {"HOME": str(tmp_path)}


def train(home: dict[str, str], folder: Path, *words: str) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "manywake.cli", "train", "--run", str(folder), *SHORT, *words]
    return subprocess.run(command, env=home, capture_output=True, text=True, timeout=300)


def trained(home: dict[str, str], folder: Path, *words: str) -> str:
    """Train as a command; return the policy's hash."""
    done = train(home, folder, *words)
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout.splitlines()[-1])["policy_sha256"]


@contextmanager
def started(home: dict[str, str]) -> Iterator[str]:
    """Start a cluster of this machine as by hand; give its address."""
    port, ray = free_port(), Path(sys.executable).parent / "ray"
    words = ["start", "--head", "--port", str(port), "--num-cpus", "2", "--include-dashboard", "false", "--block"]
    with subprocess.Popen([ray, *words], env=home, start_new_session=True, stdout=subprocess.PIPE, text=True) as head:
        try:
            for line in head.stdout:
                if "Ray runtime started" in line:
                    break
            yield f"127.0.0.1:{port}"
        finally:
            head.terminate()
            head.communicate(timeout=60)


def test_ray_of_our_own_then_a_cluster_that_was_started_by_hand(tmp_path, home):
    serial = trained(home, tmp_path / "serial", "--engine", "serial", "--workers", "1")
    assert trained(home, tmp_path / "own", "--engine", "ray") == serial
    with started(home) as address:
        assert trained(home, tmp_path / "cluster", "--engine", "ray", "--address", address) == serial


def test_a_cluster_without_the_token_of_this_home_is_refused_before_anything_is_lost(tmp_path, home):
    (tmp_path / ".ray").mkdir()
    (tmp_path / ".ray" / "auth_token").write_text(64 * "a")
    with started(home | {"RAY_AUTH_MODE": "disabled"}) as address:
        done = train(home, tmp_path / "run", "--engine", "ray", "--address", address)
    assert done.returncode == 2 and "go without it: RAY_AUTH_MODE=disabled" in done.stderr, done.stderr[-2000:]


def test_the_script_for_slurm_is_bash():
    script = Path(__file__).parents[1] / "examples" / "slurm.sh"
    done = subprocess.run(["bash", "-n", script], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
