"""Ray: the same episodes on the machines of a cluster (the extra `manywake[ray]`)."""

import faulthandler
import logging
import os
import signal
import threading
import time
from concurrent.futures import Future
from typing import Any

from manywake.learn.engine import TimedOut, WorkerDied, call


class Ray:
    """Tasks of a Ray cluster, or of a Ray of our own on this machine.

    slots: most tasks at once; fewer while the cluster has fewer cores. cpus: cores a task takes. address: of a running
    cluster (`auto` finds it); without one Ray is started here, on the loopback interface only, and ends with `close()`.
    """

    keeps_time = True

    def __init__(self, slots: int, address: str | None = None, cpus: float = 1.0):
        try:
            import ray
            from ray import exceptions
            from ray._private import ray_constants
            from ray._private.authentication.authentication_token_setup import (
                maybe_enable_token_auth_if_token_available,
            )
        except ImportError as error:
            remedy = "install it with: pip install 'manywake[ray]'"
            raise RuntimeError(f"engine: ray cannot be loaded ({error}); {remedy}") from error
        self._ray, self._exceptions, self._most, self._cpus = ray, exceptions, slots, cpus
        # Ray puts its own handler in the place of the trainer's
        before = signal.getsignal(signal.SIGTERM) if threading.current_thread() is threading.main_thread() else None
        self._mine = not ray.is_initialized()
        quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.WARNING}
        if self._mine and address is None:
            # else Ray takes the loopback address to stand for the machine's own; no public option says otherwise
            ray_constants.ENABLE_RAY_CLUSTER = False
            own: dict[str, Any] = {"num_cpus": max(1, round(slots * cpus)), "include_dashboard": False}
            ray.init(address="local", _node_ip_address="127.0.0.1", **own, **quiet)
        elif self._mine:
            # ray start demands the token that an earlier Ray of this home has left; Ray sends it to "auto" only
            maybe_enable_token_auth_if_token_available(warn_if_disabled=False)
            try:
                ray.init(address=address, **quiet)
            except (ConnectionError, ValueError) as error:
                got = f"address: got {address!r}, where no Ray cluster answers ({error})"
                raise RuntimeError(f"{got}; start one with: ray start --head, or leave --address out") from error
            if _mode() != ray.get(ray.remote(_mode).options(num_cpus=0).remote()):  # else what is shared gets lost
                ray.shutdown()
                got = f"address: got {address!r}, a cluster that was started without the token of this home"
                raise RuntimeError(f"{got}; go without it: RAY_AUTH_MODE=disabled manywake ...")
        if before is not None:
            signal.signal(signal.SIGTERM, before)
        # no retries: a lost episode is made again by the collector, who counts it
        self._call = ray.remote(_within).options(num_cpus=cpus, max_retries=0)

    @property
    def slots(self) -> int:
        cores = [node["Resources"].get("CPU", 0.0) for node in self._ray.nodes() if node["Alive"]]
        return max(1, min(self._most, sum(int(count / self._cpus) for count in cores)))

    def share(self, value: Any) -> Any:
        return self._ray.put(value)

    def submit(self, fn, *args: Any, timeout: float | None = None) -> Future:
        reference, begun = self._call.remote(timeout, fn, *args), time.monotonic()
        outer: Future = Future()
        outer.set_running_or_notify_cancel()

        def done(inner: Future) -> None:
            error = inner.exception()
            if error is None:
                outer.set_result(inner.result())
            elif isinstance(error, self._exceptions.RayTaskError):
                outer.set_exception(error.cause or error)
            elif timeout is not None and time.monotonic() - begun >= timeout:
                outer.set_exception(TimedOut(f"no result within {timeout:.0f} s"))
            elif isinstance(error, self._exceptions.RayError):
                outer.set_exception(WorkerDied(f"{type(error).__name__}: {str(error).splitlines()[0]}"))
            else:
                outer.set_exception(error)

        reference.future().add_done_callback(done)
        return outer

    def close(self) -> None:
        if self._mine:
            self._ray.shutdown()


def _mode() -> int:
    """Return whether this process of Ray demands a token and sends one."""
    from ray._private.authentication.authentication_token_setup import get_authentication_mode

    return int(get_authentication_mode())


def _within(timeout: float | None, fn, *args: Any) -> Any:
    """Compute fn(*args) in a worker that ends itself when that takes longer than `timeout` seconds.

    The clock starts with the task, however long that had to wait for a core, and needs no cooperation of fn.
    """
    if timeout is None:
        return call(fn, *args)
    with open(os.devnull, "w") as nowhere:
        faulthandler.dump_traceback_later(timeout, exit=True, file=nowhere)
        try:
            return call(fn, *args)
        finally:
            faulthandler.cancel_dump_traceback_later()
