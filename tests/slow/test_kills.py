"""Random kills: whatever is killed and when, the training ends with the bits of one that was left alone.

`python -m tests.slow.test_kills 100` does it a hundred times, and prints what was killed and when. A kill that came
after the training had ended is not counted.
"""

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest

from ..test_engine import gone

VICTIMS = ("trainer", "worker", "fork server")
ENV = ["--env", "tests.external:make"]
TRAINING = [*ENV, "--actions", "20", "--update-period", "8", "--episodes", "320", "--hidden", "16", "--workers", "2"]
CHECKOUT = Path(__file__).parents[2]
PATIENCE = {"ray": 120.0}
"""Seconds within which all processes are gone, if not 20: Ray's own that were starting wait a minute for a raylet that
is dead, then end of themselves."""
LATE = " (too late: the training had ended)"


def command(where: dict[str, str], *words) -> subprocess.Popen:
    whole = [sys.executable, "-m", "manywake.cli", *map(str, words), "--json"]
    return subprocess.Popen(whole, cwd=CHECKOUT, env=where, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def policy(ended: subprocess.Popen, may_fail: bool = False) -> str | None:
    """Wait for a command; return the policy's hash, None where it was killed, or failed and may."""
    out, err = ended.communicate(timeout=600)
    if ended.returncode == -signal.SIGKILL or ended.returncode and may_fail:
        return None
    assert ended.returncode == 0, err[-2000:]
    return json.loads(out.splitlines()[-1])["policy_sha256"]


def family(process: int) -> dict[int, str]:
    """Return the descendants of a process by number, with their command lines."""
    parents, lines = {}, {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                parents[int(entry.name)] = int((entry / "stat").read_text().rsplit(")", 1)[1].split()[1])
                lines[int(entry.name)] = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
            except OSError:
                continue
    found, new = {process}, {process}
    while new:
        new = {child for child, parent in parents.items() if parent in new} - found
        found |= new
    return {child: lines[child] for child in found - {process} if child in lines}


def chosen(trainer: int, victim: str, rng: np.random.Generator) -> int | None:
    """Return the process to be killed, None where there is none of the kind yet."""
    if victim == "trainer":
        return trainer
    kin = family(trainer)
    servers = [child for child, line in kin.items() if "multiprocessing.forkserver import main" in line]
    children = {child for server in servers for child in family(server)}
    tracked = [child for child, line in kin.items() if "raylet" in line.split(" ")[0] or "ray::" in line]
    among = {"worker": sorted(children), "fork server": sorted(set(servers) - children), "ray": sorted(tracked)}[victim]
    return int(rng.choice(among)) if among else None


def survived(victim: str, seed: int, seconds: float, wanted: str) -> str:
    """Train, kill one process at a random time, go on if need be; return what was done.

    AssertionError where bits, a process or a folder tell of it.
    """
    rng = np.random.default_rng(seed)
    engine = "ray" if victim == "ray" else "processes"
    with tempfile.TemporaryDirectory(prefix="k", dir="/tmp") as made:
        folder, temporary = Path(made) / "run", Path(made) / "t"
        temporary.mkdir()
        where = os.environ | {"TMPDIR": str(temporary)}
        running = command(where, "train", *TRAINING, "--engine", engine, "--run", folder)
        while victim == "ray" and chosen(running.pid, victim, rng) is None and running.poll() is None:
            time.sleep(0.05)  # Ray of our own takes seconds to start
        delay = rng.uniform(0.0, seconds)
        time.sleep(delay)
        while (process := chosen(running.pid, victim, rng)) is None and running.poll() is None:
            time.sleep(0.05)
        kin, late = list(family(running.pid)), running.poll() is not None
        if process is not None and not late:
            os.kill(process, signal.SIGKILL)
        found = policy(running, may_fail=victim == "ray")  # a Ray of our own may go with its raylet
        assert all(gone(process, PATIENCE.get(victim, 20.0)) for process in kin), "processes are left"
        while found is None:
            words = (
                ("resume", folder, *ENV)
                if (folder / "settings.json").exists()
                else ("train", *TRAINING, "--run", folder)
            )
            found = policy(command(where, *words))
        assert found == wanted, "another policy"
        # Ray keeps its logs, torch a folder for compiled code
        left = [path.name for path in temporary.iterdir() if not path.name.startswith(("ray", "torchinductor"))]
        assert not left, f"left: {left}"
        return f"{victim} at {delay:.2f} s" + (LATE if late else "")


def undisturbed() -> tuple[str, float]:
    """Return the policy of a training that is left alone, and the seconds that it takes."""
    with tempfile.TemporaryDirectory() as made:
        begin = time.monotonic()
        found = policy(command(dict(os.environ), "train", *TRAINING, "--run", Path(made) / "run"))
        assert found is not None
        return found, time.monotonic() - begin


@pytest.fixture(scope="module")
def alone():
    return undisturbed()


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("victim", [*VICTIMS, "ray"])
def test_a_kill_costs_no_bit_and_leaves_nothing(alone, victim, seed):
    wanted, seconds = alone
    survived(victim, seed, seconds, wanted)


if __name__ == "__main__":
    policy_alone, seconds_alone = undisturbed()
    print(f"alone: {seconds_alone:.1f} s", flush=True)
    k, late = 0, 0
    while k < int(sys.argv[1]):
        kind = "ray" if k % 10 == 9 else VICTIMS[k % 3]
        told = survived(kind, k + 1000 * late, seconds_alone, policy_alone)
        print(k, told, flush=True)
        if told.endswith(LATE):  # the machine has become faster since
            late, seconds_alone = late + 1, 0.9 * seconds_alone
        else:
            k += 1
