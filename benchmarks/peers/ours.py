"""Ours: the flow of `manywake train` at several batch widths: control law, forces, probes and observation included.

Run: python benchmarks/peers/ours.py 1 8 16 32
"""

import json
import sys

import shared  # first: it keeps the libraries to one thread

# isort: split
import numpy as np

from manywake.env.task import ControlledFlow, Task
from manywake.flow import baseline
from manywake.flow.case import CASES


def main(widths: list[int], blocks: int = 8) -> None:
    case, task = CASES["cylinder-jets"], Task()
    ops, base = baseline.assembled(case)
    rng = np.random.default_rng(0)
    flows = {width: ControlledFlow(ops, base, task, width) for width in widths}
    clocks = {width: shared.Clock() for width in widths}
    for flow in flows.values():  # compile, warm up
        flow.act(np.zeros(flow.flow.flows))
        flow.observe()
    for _ in range(blocks):
        for width, flow in flows.items():

            def work(flow=flow, width=width):
                flow.act(rng.uniform(-1, 1, width))
                flow.observe()

            clocks[width].run(work, flow.steps * width)
    shared.finish(
        {
            "case": case.name,
            "triangles": len(base.mesh.triangles),
            "velocity_dofs": 2 * len(ops.velocity_order),
            "pressure_dofs": len(ops.pressure_order),
            "time_step": case.time_step,
            "scheme": case.scheme.name,
            "widths": {width: {"wall_ms": clock.wall, "cpu_ms": clock.cpu} for width, clock in clocks.items()},
            "statistics": {
                "cd_mean": base.shedding.cd_mean,
                "cl_max": base.shedding.cl_max,
                "strouhal": base.shedding.strouhal(case.diameter),
                "periods": base.shedding.periods,
            },
        }
    )


if __name__ == "__main__":
    main(json.loads("[" + ",".join(sys.argv[1:]) + "]") or [1, 8, 16, 32])
