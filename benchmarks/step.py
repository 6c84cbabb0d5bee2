"""Milliseconds per flow and time step against the batch width, on one core: control law, forces and probes included.

Run: manywake bench step --lanes 1 8 16 32 --json
"""

import os
import statistics
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from manywake.env.control import ControlledFlows
from manywake.flow import store
from manywake.suite import load

ACTIONS = 4
REPEATS = 7


def measure(lanes: Sequence[int]) -> dict[str, Any]:
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    chosen = load.choose(load.DEFAULT)
    flow = store.flow(chosen.case)
    ops = flow.operators
    rng = np.random.default_rng(0)
    batches = {width: ControlledFlows(flow, chosen.task, width) for width in lanes}
    for width, flows in batches.items():  # compile, warm up
        flows.act(np.zeros((width, 1)))
    samples: dict[int, list[float]] = {width: [] for width in lanes}
    for _ in range(REPEATS):  # the widths in turn, so that a drift of the machine meets all of them
        for width, flows in batches.items():
            start = time.perf_counter()
            for _ in range(ACTIONS):
                flows.act(rng.uniform(-1, 1, (width, 1)))
                flows.observe()
            samples[width].append((time.perf_counter() - start) * 1e3 / (ACTIONS * flows.steps * width))
    return {
        "case": chosen.definition.name,
        "elements": len(ops.mesh.triangles),
        "dofs": 2 * len(ops.velocity_order) + len(ops.pressure_order),
        "velocity_dofs": 2 * len(ops.velocity_order),
        "pressure_dofs": len(ops.pressure_order),
        "dt": chosen.case.dt,
        "ms_per_flow_step": {str(width): statistics.median(values) for width, values in samples.items()},
        "spread_ms": {str(width): [min(values), max(values)] for width, values in samples.items()},
    }
