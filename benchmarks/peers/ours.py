"""Ours: the flow of `manywake train` at several batch widths: control law, forces, probes and observation included.

Run: python benchmarks/peers/ours.py 1 8 16 32
"""

import json
import sys

import shared  # first: it keeps the libraries to one thread

# isort: split
import numpy as np

from manywake.env.control import ControlledFlows
from manywake.flow import store
from manywake.suite import load


def main(widths: list[int], blocks: int = 8) -> None:
    chosen = load.choose(load.DEFAULT)
    case, flow = chosen.case, store.flow(chosen.case)
    ops, free = flow.operators, flow.baseline.statistics
    rng = np.random.default_rng(0)
    batches = {width: ControlledFlows(flow, chosen.task, width) for width in widths}
    clocks = {width: shared.Clock() for width in widths}
    for width, flows in batches.items():  # compile, warm up
        flows.act(np.zeros((width, 1)))
        flows.observe()
    for _ in range(blocks):
        for width, flows in batches.items():

            def work(flows=flows, width=width):
                flows.act(rng.uniform(-1, 1, (width, 1)))
                flows.observe()

            clocks[width].run(work, flows.steps * width)
    shared.finish(
        {
            "case": chosen.definition.name,
            "triangles": len(ops.mesh.triangles),
            "velocity_dofs": 2 * len(ops.velocity_order),
            "pressure_dofs": len(ops.pressure_order),
            "time_step": case.dt,
            "scheme": case.scheme.name,
            "widths": {width: {"wall_ms": clock.wall, "cpu_ms": clock.cpu} for width, clock in clocks.items()},
            "statistics": {
                "cd_mean": free["c_d"].mean,
                "cl_max": free["c_l"].high,
                "strouhal": case.convective_time / free.period,
            },
        }
    )


if __name__ == "__main__":
    main(json.loads("[" + ",".join(sys.argv[1:]) + "]") or [1, 8, 16, 32])
