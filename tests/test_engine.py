"""Engines: a future tells a result from an exception, a dead worker and a time-out; closing leaves nobody behind."""

import os
import signal
import subprocess
import sys
import tempfile
import textwrap
import time
from multiprocessing import forkserver
from pathlib import Path

import pytest

from manywake.learn.engine import Processes, Threads, TimedOut, WorkerDied

pytestmark = pytest.mark.alone


def double(x):
    return 2 * x


def bad(x):
    raise ArithmeticError(f"{x} is bad")


class Unsendable(Exception):
    def __init__(self, a, b):
        super().__init__(a)


def unsendable():
    raise Unsendable(1, 2)


def out_of_memory():
    raise MemoryError("no room")


def pid():
    return os.getpid()


def die(number):
    os.kill(os.getpid(), number)


def hang():
    while True:
        time.sleep(60)


@pytest.fixture
def temporary():
    """Return a folder for temporary files of other processes; its path is short, as sockets want it."""
    with tempfile.TemporaryDirectory(prefix="t", dir="/tmp") as folder:
        yield folder


def emptied(folder) -> bool:
    """Return whether no folder is left in a folder, within thirty seconds: a busy machine takes its time.

    A file may be: Python writes one to see whether it can, and may be killed before it has removed it.
    """
    for _ in range(3000):
        if not any(path.is_dir() for path in Path(folder).iterdir()):
            return True
        time.sleep(0.01)
    return False


def alive(process: int) -> bool:
    """Return whether a process runs; a zombie does not."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except (FileNotFoundError, ProcessLookupError):
        return False


def gone(process: int, seconds: float = 30.0) -> bool:
    """Return whether a process has ended, within some seconds."""
    until = time.monotonic() + seconds
    while alive(process) and time.monotonic() < until:
        time.sleep(0.02)
    return not alive(process)


@pytest.fixture(params=[Threads, Processes])
def engine(request):
    made = request.param(2)
    yield made
    made.close()


@pytest.fixture
def processes():
    made = Processes(2)
    yield made
    made.close()


def test_a_future_ends_in_the_result(engine):
    assert [f.result(60) for f in [engine.submit(double, k) for k in range(5)]] == [0, 2, 4, 6, 8]


def test_a_future_ends_in_the_exception_that_was_raised(engine):
    with pytest.raises(ArithmeticError, match="7 is bad"):
        engine.submit(bad, 7).result(60)
    assert engine.submit(double, 4).result(60) == 8


def test_what_is_shared_arrives(engine):
    shared = engine.share({"a": 1.5})
    assert engine.submit(dict.__getitem__, shared, "a").result(60) == 1.5


def test_an_exception_that_cannot_travel_comes_as_its_text(processes):
    with pytest.raises(RuntimeError, match="Unsendable: 1"):
        processes.submit(unsendable).result(60)
    assert processes.submit(double, 4).result(60) == 8


def test_memory_that_runs_out_is_an_exception_of_its_task_only(processes):
    with pytest.raises(MemoryError):
        processes.submit(out_of_memory).result(60)
    assert processes.submit(double, 4).result(60) == 8


def test_a_killed_worker_is_told_and_replaced_and_harms_no_other(processes):
    other = processes.submit(time.sleep, 1.0)
    with pytest.raises(WorkerDied, match="signal 9"):
        processes.submit(die, signal.SIGKILL).result(60)
    assert other.result(60) is None
    workers = {processes.submit(pid).result(60) for _ in range(4)}
    assert os.getpid() not in workers


def test_a_worker_that_ends_of_itself_is_told_too(processes):
    with pytest.raises(WorkerDied, match="exit code 0"):
        processes.submit(os._exit, 0).result(60)


def test_an_idle_worker_that_was_killed_is_replaced(processes):
    victim = processes.submit(pid).result(60)
    os.kill(victim, signal.SIGKILL)
    assert gone(victim)
    results = []
    for k in range(6):
        try:
            results.append(processes.submit(double, k).result(60))
        except WorkerDied:
            results.append("died")
    assert results.count("died") <= 1
    assert results[-3:] == [6, 8, 10]


def test_a_task_that_comes_while_its_idle_worker_is_found_dead_is_not_forgotten():
    engine = Processes(1)
    try:
        victim = engine.submit(pid).result(60)
        manager = engine._free[0]._pool_manager
        usual = manager.schedule

        def late(task):
            os.kill(victim, signal.SIGKILL)
            while manager.context.alive:  # until the pool has found its worker dead, and ended all tasks it knew of
                time.sleep(0.01)
            time.sleep(0.1)
            usual(task)

        manager.schedule = late
        with pytest.raises(WorkerDied):
            engine.submit(double, 3).result(30)
        assert engine.submit(double, 4).result(60) == 8
    finally:
        engine.close()


def test_a_worker_that_hangs_past_its_time_is_told_and_ended(processes):
    worker = processes.submit(pid).result(60)
    futures = [processes.submit(hang, timeout=0.5) for _ in range(2)]
    for future in futures:
        with pytest.raises(TimedOut, match="no result within"):
            future.result(60)
    assert processes.submit(double, 4).result(60) == 8
    assert gone(worker)


def test_closing_leaves_no_process_behind_even_amid_work():
    engine = Processes(3)
    workers = {engine.submit(pid).result(60) for _ in range(6)}
    engine.submit(hang)
    engine.close()
    assert all(gone(worker) for worker in workers)
    with pytest.raises(RuntimeError, match="closed"):
        engine.submit(pid)


@pytest.mark.parametrize("tasks", [2, 0], ids=["busy", "idle"])
def test_workers_end_when_their_trainer_is_killed_and_leave_nothing(tmp_path, temporary, tasks):
    script = tmp_path / "trainer.py"
    script.write_text(
        textwrap.dedent(
            """
            import os, sys, time
            from manywake.learn.engine import Processes

            if __name__ == "__main__":
                engine = Processes(2)
                shared = engine.share(1)
                print(shared.path, *{engine.submit(os.getpid).result(60) for _ in range(8)}, flush=True)
                futures = [engine.submit(time.sleep, 600) for _ in range(int(sys.argv[1]))]
                time.sleep(600)
            """
        )
    )
    words, where = [sys.executable, script, str(tasks)], os.environ | {"TMPDIR": temporary}
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env=where) as trainer:
        try:
            path, *workers = trainer.stdout.readline().split()
            assert workers and os.path.exists(path)
        finally:
            trainer.kill()
    assert all(gone(int(worker)) for worker in workers)
    assert emptied(temporary)


@pytest.mark.parametrize("seconds", [0.0, 0.05, 0.2, 0.5, 1.0, 2.0])
def test_a_trainer_that_is_killed_while_it_starts_leaves_nothing(tmp_path, temporary, seconds):
    script = tmp_path / "trainer.py"
    script.write_text(
        textwrap.dedent(
            """
            import time
            from manywake.learn.engine import Processes

            if __name__ == "__main__":
                print("begins", flush=True)
                engine = Processes(2)
                time.sleep(600)
            """
        )
    )
    given = os.environ | {"TMPDIR": temporary}
    with subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, text=True, env=given) as trainer:
        assert trainer.stdout.readline() == "begins\n"
        time.sleep(seconds)
        trainer.kill()
    # killed between making the folder and starting the server, it is the next trainer that removes what is left
    if seconds == 0.0 and not emptied(temporary):
        subprocess.run([sys.executable, "-c", f"from manywake.machine import room; {SWEEP}"], env=given, check=True)
    assert emptied(temporary), [str(path) for path in Path(temporary).rglob("*")]


SWEEP = (
    "import pathlib, os; [(os.utime(p, (0, 0)), room.sweep(p)) for p in pathlib.Path(os.environ['TMPDIR']).iterdir()]"
)


def test_a_killed_fork_server_loses_what_was_under_way_and_no_more(processes):
    shared = processes.share(41)
    assert processes.submit(double, shared).result(60) == 82
    server = processes.submit(os.getppid).result(60)
    under_way = [processes.submit(hang) for _ in range(2)]
    os.kill(server, signal.SIGKILL)
    for future in under_way:
        with pytest.raises(WorkerDied):
            future.result(60)
    assert processes.submit(double, shared).result(60) == 82


def test_a_fork_server_that_is_killed_while_it_starts_a_worker_costs_nothing(processes, monkeypatch):
    server, usual, killed = processes.submit(os.getppid).result(60), forkserver.read_signed, []

    def after_a_kill(connected):
        if not killed:
            killed.append(server)
            os.kill(server, signal.SIGKILL)
        return usual(connected)

    monkeypatch.setattr(forkserver, "read_signed", after_a_kill)
    os.kill(server, signal.SIGSTOP)  # so that it answers nobody
    engine = Processes(2)
    try:
        assert [engine.submit(double, k).result(60) for k in range(4)] == [0, 2, 4, 6]
    finally:
        engine.close()
    assert killed


def test_a_full_disk_is_named_by_the_folder_it_is_in(tmp_path, temporary):
    script = tmp_path / "trainer.py"
    script.write_text(
        textwrap.dedent(
            """
            import resource
            from manywake.learn.engine import Processes

            if __name__ == "__main__":
                engine = Processes(1)
                resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
                try:
                    engine.share(bytes(10000))
                except OSError as error:
                    print(error)
                engine.close()
            """
        )
    )
    given = os.environ | {"TMPDIR": temporary}
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, env=given, check=True)
    assert f"File too large: '{temporary}/manywake-room-" in done.stdout
    assert emptied(temporary)


@pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="needs a folder on a disk without room")
def test_a_full_cache_costs_a_compilation_and_no_more():
    code = (
        "import numpy as np; from manywake.machine.compile import kernel\n"
        "@kernel\ndef double(x):\n    return 2 * x\n"
        "print(double(21))"
    )
    given = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"} | {
        "XDG_CACHE_HOME": "/proc"
    }
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=given)
    assert done.stdout == "42\n", done.stderr
    assert "cache: /proc has 0 MB of free space, wanted 100 MB" in done.stderr
