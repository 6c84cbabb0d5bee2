"""Where episodes are computed. A future ends in fn's result, in its exception, in `WorkerDied` or in `TimedOut`.

Nothing is tried again here; that is the collector's, who knows that an episode made twice has the same bits.
"""

import multiprocessing
import os
import pickle
import shutil
import tempfile
import threading
import weakref
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import lru_cache, partial
from multiprocessing import connection, forkserver, util
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from manywake.machine import room

if TYPE_CHECKING:
    from pebble import ProcessPool

LONGEST = 60
"""Characters of a folder that a socket's path may begin with: in all it has 100 or so."""


class WorkerDied(RuntimeError):
    """The process that computed is gone: killed, crashed, out of memory, or its machine lost."""


class TimedOut(RuntimeError):
    """The computation took longer than it was given; its process was ended."""


class Engine(Protocol):
    """Computes functions of plain arguments, `slots` at a time, as of now."""

    keeps_time: bool
    """Whether a computation past its timeout is ended."""

    @property
    def slots(self) -> int: ...

    def share(self, value: Any) -> Any:
        """Return what stands for `value` as an argument of `submit`, as long as it lives: large values travel once."""

    def submit(self, fn, *args: Any, timeout: float | None = None) -> Future:
        """Start fn(*args), given at most `timeout` seconds."""

    def close(self) -> None:
        """Stop all; no process is left."""


class Threads:
    """Threads of this process: the kernels release the interpreter lock. `Threads(1)` is the serial engine.

    A thread cannot be stopped, so `timeout` is not kept, and what still plays at `close` plays on unheard.
    """

    keeps_time = False

    def __init__(self, slots: int):
        self.slots = slots
        self._pool = ThreadPoolExecutor(slots)

    def share(self, value: Any) -> Any:
        return value

    def submit(self, fn, *args: Any, timeout: float | None = None) -> Future:
        return self._pool.submit(fn, *args)

    def close(self) -> None:
        self._pool.shutdown(wait=False, cancel_futures=True)


class Processes:
    """Processes of this machine. One that dies or takes too long is replaced, and harms no other.

    Each slot is a pebble pool of one worker, for pebble's workers share a pipe and its lock: one killed while it sends
    a result would take the others with it. Workers end with the process that made them, however that one ends, and what
    it shared with them goes too (`machine.room`).
    """

    keeps_time = True

    def __init__(self, slots: int):
        self.slots = slots
        _context()  # first the server: it removes what is left of this process's folder where that is killed
        self._folder = tempfile.mkdtemp(dir=room.folder())
        self._lock, self._closed = threading.Lock(), False
        self._free = [self._pool() for _ in range(slots)]
        self._pools = set(self._free)
        self._under_way: dict[ProcessPool, Future] = {}
        for pool in tuple(self._free):
            try:
                pool.schedule(int)  # a pool starts its worker with its first task: let all of them start together
            except RuntimeError:  # the server that forks it was killed just now
                self._free.remove(pool)
                self._drop(pool)

    def _pool(self) -> "ProcessPool":
        from pebble import ProcessPool

        pool = ProcessPool(1, initializer=_end_with_parent, context=_context())
        workers = pool._pool_manager.worker_manager
        # pebble takes a worker that ends with code 0 for one that was told to; ours never are
        workers.inspect_workers = partial(_ended, workers.workers)  # type: ignore[method-assign]
        # and it forgets a task that it takes up while it finds that its worker has died idle
        manager = pool._pool_manager
        manager.handle_broken_pool = partial(self._broken, pool, manager.handle_broken_pool)  # type: ignore[method-assign]
        return pool

    def share(self, value: Any) -> Any:
        with tempfile.NamedTemporaryFile(dir=self._folder, delete=False) as file:
            try:
                pickle.dump(value, file, pickle.HIGHEST_PROTOCOL)  # read by our own workers only, as from a pipe
                file.flush()
            except OSError as error:  # a full disk names no file
                Path(file.name).unlink()
                raise OSError(error.errno, error.strerror, self._folder) from error
        shared = Shared(file.name)
        weakref.finalize(shared, Path(file.name).unlink, missing_ok=True)
        return shared

    def submit(self, fn, *args: Any, timeout: float | None = None) -> Future:
        outer: Future = Future()
        outer.set_running_or_notify_cancel()
        inner = None
        while inner is None:
            with self._lock:
                if self._closed:
                    raise RuntimeError("engine: closed")
                if not self._free:
                    self._free.append(self._pool())
                    self._pools.update(self._free)
                pool = self._free.pop()
                self._under_way[pool] = outer
            try:
                inner = pool.schedule(call, args=[fn, *args], timeout=timeout)
            except RuntimeError:  # its worker died while it had nothing to do
                if self._taken(pool) is None:
                    return outer
                self._drop(pool)
        inner.add_done_callback(lambda done: self._done(pool, done, outer))
        return outer

    def _taken(self, pool: "ProcessPool") -> Future | None:
        """Return what a pool had under way, for whoever asks first: that one ends it."""
        with self._lock:
            return self._under_way.pop(pool, None)

    def _broken(
        self, pool: "ProcessPool", usual: Callable[[BrokenProcessPool], None], error: BrokenProcessPool
    ) -> None:
        """End what a broken pool has under way, whether it knows of it or not."""
        usual(error)
        if (outer := self._taken(pool)) is not None:
            if not self._closed:
                self._drop(pool)
            outer.set_exception(_told_apart(error))

    def _drop(self, pool: "ProcessPool") -> None:
        with self._lock:
            self._pools.discard(pool)
        threading.Thread(target=_stop, args=[pool], daemon=True).start()

    def _done(self, pool: "ProcessPool", inner: Future, outer: Future) -> None:
        if self._taken(pool) is None:
            return
        error = WorkerDied("the engine was closed") if inner.cancelled() else _told_apart(inner.exception())
        with self._lock:
            keep = len(self._free) < self.slots and not isinstance(error, WorkerDied | TimedOut)
            if keep:
                self._free.append(pool)
        if not keep and not self._closed:
            self._drop(pool)
        if error is None:
            outer.set_result(inner.result())
        else:
            outer.set_exception(error)

    def close(self) -> None:
        with self._lock:
            self._closed = True
        stopping = [threading.Thread(target=_stop, args=[pool], daemon=True) for pool in self._pools]
        for thread in stopping:
            thread.start()
        for thread in stopping:
            thread.join()
        shutil.rmtree(self._folder, ignore_errors=True)


class Shared:
    """Stands for a value that lies in a file of the engine's own folder."""

    def __init__(self, path: str):
        self.path = path


@lru_cache(maxsize=16)
def _read(path: str) -> Any:
    return pickle.loads(Path(path).read_bytes())


def call(fn, *args: Any) -> Any:
    """Compute fn(*args) in a worker. An exception that would not survive the way back is replaced by its text."""
    try:
        return fn(*(_read(value.path) if isinstance(value, Shared) else value for value in args))
    except Exception as error:
        try:
            pickle.loads(pickle.dumps(error))
        except Exception:
            raise RuntimeError(f"{type(error).__name__}: {error}") from None
        raise


def _told_apart(error: BaseException | None) -> BaseException | None:
    """Return the error of a pebble future as one of ours where it is about the worker."""
    from pebble import ProcessExpired

    if isinstance(error, ProcessExpired):
        how = f"signal {-error.exitcode}" if error.exitcode < 0 else f"exit code {error.exitcode}"
        hint = "; the system does that when memory runs out" if error.exitcode == -9 else ""
        return WorkerDied(f"worker {error.pid} ended with {how}{hint}")
    if isinstance(error, BrokenProcessPool):
        return WorkerDied(f"worker ended before its task began ({error})")
    if isinstance(error, TimeoutError) and error.args[:1] == ("Task timeout",):
        return TimedOut(f"no result within {error.args[1]:.0f} s")
    return error


def _ended(workers: dict[int, Any]) -> tuple[tuple[int, int], ...]:
    """Take out the workers that have ended; return their process numbers and exit codes."""
    ended = [process for process in tuple(workers.values()) if not process.is_alive()]
    return tuple((process.pid, workers.pop(process.pid).exitcode) for process in ended)


def _stop(pool: "ProcessPool") -> None:
    pool.stop()
    pool.join()


def _context():
    """Return the way to start workers: forked from a server that has imported what they need, where there is one.

    It starts before any thread of ours can matter to it, and with one BLAS thread, so that forking is safe. One that
    was killed is started anew, likewise.
    """
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["__main__", "manywake.learn.flows"])
    alone = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    before = {name: os.environ[name] for name in alone if name in os.environ}
    os.environ.update(alone)
    usual, ours = tempfile.tempdir, str(room.folder())
    try:
        if len(ours) < LONGEST:
            tempfile.tempdir = ours
        util.get_temp_dir()  # multiprocessing makes it once; in ours it goes with ours
        forkserver.ensure_running()
    finally:
        tempfile.tempdir = usual
        for name in alone:
            del os.environ[name]
        os.environ.update(before)
    return context


def _end_with_parent() -> None:
    """End this worker as soon as the process that started it is gone, even by kill -9."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    gone = parent.sentinel

    def watch() -> None:
        connection.wait([gone])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
