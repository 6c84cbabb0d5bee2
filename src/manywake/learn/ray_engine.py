"""Ray: the same episodes on the machines of a cluster (the extra `manywake[ray]`)."""

import logging
import threading
from concurrent.futures import Future
from typing import Any

from manywake.learn.engine import TimedOut, WorkerDied, call


class Ray:
    """Tasks of a Ray cluster, or of a Ray of our own on this machine.

    slots: at most this many tasks at once; fewer while the cluster has fewer cores. cpus: cores a task takes. address:
    of a running cluster (`auto` finds it); without one, Ray is started here, listens on the loopback interface only,
    and ends with `close()`.
    """

    def __init__(self, slots: int, address: str | None = None, cpus: float = 1.0):
        try:
            import ray
            from ray import exceptions
            from ray._private import ray_constants
        except ImportError as error:
            raise RuntimeError(
                f"engine: ray cannot be loaded ({error}); install it with: pip install 'manywake[ray]'"
            ) from error
        self._ray, self._exceptions = ray, exceptions
        self._most, self._cpus = slots, cpus
        self._mine = not ray.is_initialized()
        if self._mine and address is None:
            # else Ray takes the loopback address to stand for the machine's own; no public option says otherwise
            ray_constants.ENABLE_RAY_CLUSTER = False
            ray.init(
                address="local",
                num_cpus=max(1, round(slots * cpus)),
                include_dashboard=False,
                _node_ip_address="127.0.0.1",
                log_to_driver=False,
                logging_level=logging.WARNING,
            )
        elif self._mine:
            ray.init(address=address, log_to_driver=False, logging_level=logging.WARNING)
        # no retries: a lost episode is made again by the collector, who counts it
        self._call = ray.remote(call).options(num_cpus=cpus, max_retries=0)

    @property
    def slots(self) -> int:
        cores = self._ray.cluster_resources().get("CPU", 0.0)
        return max(1, min(self._most, int(cores / self._cpus)))

    def share(self, value: Any) -> Any:
        return self._ray.put(value)

    def submit(self, fn, *args: Any, timeout: float | None = None) -> Future:
        reference = self._call.remote(fn, *args)
        outer: Future = Future()
        outer.set_running_or_notify_cancel()
        late = threading.Event()

        def stop() -> None:
            late.set()
            self._ray.cancel(reference, force=True)

        timer = threading.Timer(timeout, stop) if timeout is not None else None
        if timer is not None:
            timer.daemon = True
            timer.start()

        def done(inner: Future) -> None:
            if timer is not None:
                timer.cancel()
            error = inner.exception()
            if error is None:
                outer.set_result(inner.result())
            elif late.is_set():
                outer.set_exception(TimedOut(f"no result within {timeout:.0f} s"))
            elif isinstance(error, self._exceptions.RayTaskError):
                outer.set_exception(error.cause or error)
            elif isinstance(error, self._exceptions.RayError):
                outer.set_exception(WorkerDied(f"{type(error).__name__}: {str(error).splitlines()[0]}"))
            else:
                outer.set_exception(error)

        reference.future().add_done_callback(done)
        return outer

    def close(self) -> None:
        if self._mine:
            self._ray.shutdown()
