"""Milliseconds per flow and time step against the batch width, on one core: control law, forces and probes included.

Run: manywake bench step --lanes 1 8 16 32 --json
"""

import os
import statistics
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from manywake.env.task import ControlledFlow, Task
from manywake.flow import baseline
from manywake.flow.case import CASES

ACTIONS = 4
REPEATS = 7


def measure(lanes: Sequence[int]) -> dict[str, Any]:
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    case, task = CASES["cylinder-jets"], Task()
    ops, base = baseline.assembled(case)
    rng = np.random.default_rng(0)
    flows = {width: ControlledFlow(ops, base, task, width) for width in lanes}
    for flow in flows.values():  # compile, warm up
        flow.act(np.zeros(flow.flow.flows))
    samples: dict[int, list[float]] = {width: [] for width in lanes}
    for _ in range(REPEATS):  # the widths in turn, so that a drift of the machine meets all of them
        for width, flow in flows.items():
            start = time.perf_counter()
            for _ in range(ACTIONS):
                flow.act(rng.uniform(-1, 1, width))
                flow.observe()
            samples[width].append((time.perf_counter() - start) * 1e3 / (ACTIONS * flow.steps * width))
    return {
        "case": case.name,
        "elements": len(base.mesh.triangles),
        "dofs": 2 * len(ops.velocity_order) + len(ops.pressure_order),
        "velocity_dofs": 2 * len(ops.velocity_order),
        "pressure_dofs": len(ops.pressure_order),
        "dt": case.time_step,
        "ms_per_flow_step": {str(width): statistics.median(values) for width, values in samples.items()},
        "spread_ms": {str(width): [min(values), max(values)] for width, values in samples.items()},
    }
