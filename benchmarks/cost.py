"""How the cost grows with the mesh, on one core: time and memory of a flow against the number of triangles.

Run: manywake bench cost --json   (needs the gmsh extra)

The meshes are the shipped one's sizes times a factor. Time is that of blocks of eight lanes, forces included, from a
state at rest: a step costs the same whatever the flow does. Memory of a flow is what a batch of eight holds and, for
the time of a call, needs beside it, over eight; what all flows of a process share is given apart.
"""

import dataclasses
import os
import statistics
import time
import tracemalloc
from typing import Any

import numpy as np

from manywake.flow import archive, baseline, mesh, problem
from manywake.flow.batch import FlowBatch, Start
from manywake.flow.operators import Operators
from manywake.suite.cylinder_jets import CASE

FACTORS = (2.2, 1.6, 1.0, 0.7, 0.5, 0.38, 0.27, 0.19)
LENGTHS = ("body", "layer_height", "wake", "far")
STEPS, REPEATS, LANES = 20, 7, 8


def build(factor: float) -> Operators:
    """Assemble the case on a mesh whose triangles are `factor` times as long, with a uniform mean flow."""
    lengths = {name: factor * getattr(CASE.sizes, name) for name in LENGTHS}
    facets = max(1, round(CASE.sizes.part_facets / factor))
    case = dataclasses.replace(CASE, sizes=dataclasses.replace(CASE.sizes, **lengths, part_facets=facets))
    posed = problem.pose(case, mesh.build(case))
    return baseline.assemble(case, posed, np.tile([1.0, 0.0], (len(posed.space.x), 1)))


def row(factor: float) -> dict[str, Any]:
    start = time.perf_counter()
    ops = build(factor)
    assembled = time.perf_counter() - start
    n, m = len(ops.velocity_order), len(ops.pressure_order)
    rest = Start(np.zeros((n, 2)), np.zeros((n, 2)), np.zeros(m), np.zeros(m), np.zeros(m))
    still = np.zeros((STEPS, len(ops.inputs), LANES))
    FlowBatch(ops, rest, LANES).advance(still)  # loads compiled code
    tracemalloc.start()
    flow = FlowBatch(ops, rest, LANES)
    flow.advance(still)
    held, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    samples = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        flow.advance(still)
        samples.append((time.perf_counter() - start) * 1e3 / (STEPS * LANES))
    shared = sum(array.nbytes for array in archive.arrays(ops).values())
    return {
        "triangles": len(ops.mesh.triangles),
        "velocity_dofs": 2 * n,
        "factor_entries": len(ops.tables.momentum.lower) + len(ops.tables.momentum.upper),
        "assemble_s": assembled,
        "ms_per_flow_step": statistics.median(samples),
        "spread_ms": [min(samples), max(samples)],
        "us_per_triangle": statistics.median(samples) * 1e3 / len(ops.mesh.triangles),
        "mbyte_per_flow_held": held / LANES / 1e6,
        "mbyte_per_flow_most": most / LANES / 1e6,
        "mbyte_shared": shared / 1e6,
    }


def measure() -> dict[str, Any]:
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    return {"lanes": LANES, "meshes": [row(factor) for factor in FACTORS]}
