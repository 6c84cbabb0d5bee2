"""Where episodes are computed: anything with `submit(fn, *args, timeout) -> Future`, `slots` and `close()`."""

from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, Protocol


class Engine(Protocol):
    """Computes functions of plain arguments, `slots` at a time."""

    slots: int

    def submit(self, fn, *args: Any, timeout: float | None = None) -> Future:
        """Start fn(*args); the future ends in its result or its exception."""

    def close(self) -> None:
        """Stop; what has not started is dropped."""


class Threads:
    """Threads of this process: the kernels release the interpreter lock, so `slots` blocks advance at once.

    There is one thread more than slots (but for one), so that blocks of unequal width, 8, 8 and 4 columns of twenty
    say, share the cores evenly instead of one waiting for another to end.
    """

    def __init__(self, slots: int):
        self.slots = slots
        self._pool = ThreadPoolExecutor(slots + 1 if slots > 1 else 1)

    def submit(self, fn, *args: Any, timeout: float | None = None) -> Future:
        """Start fn(*args) when a thread is free. A thread cannot be stopped, so `timeout` is not kept here."""
        return self._pool.submit(fn, *args)

    def close(self) -> None:
        """Drop what has not started and wait for what has."""
        self._pool.shutdown(cancel_futures=True)
