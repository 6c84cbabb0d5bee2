"""Pictures a second of the default case, on one core, beside what the flow itself takes for an action.

Run: manywake bench draw --json
"""

import os
import statistics
import time
from typing import Any

import numpy as np

from manywake.env.control import ControlledFlows
from manywake.env.scene import Scene
from manywake.flow import store
from manywake.suite import load

REPEATS = 50


def measure() -> dict[str, Any]:
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    chosen = load.choose(load.DEFAULT)
    flow = store.flow(chosen.case)
    begin = time.perf_counter()
    scene, flows = Scene(flow, 4.0), ControlledFlows(flow, chosen.task, 1)
    made = time.perf_counter() - begin
    traces = [(0.025 * k, 3.2, 0.1) for k in range(160)]
    picture = scene.frame(flows.batch.state(0), np.zeros(2), traces)
    drawing, acting = [], []
    for _ in range(REPEATS):  # in turn, so that a drift of the machine meets both
        begin = time.perf_counter()
        flows.act(np.zeros((1, 1)))
        middle = time.perf_counter()
        scene.frame(flows.batch.state(0), np.zeros(2), traces)
        acting.append(middle - begin)
        drawing.append(time.perf_counter() - middle)
    return {
        "case": chosen.definition.name,
        "pixels": list(picture.shape[1::-1]),
        "pictures_per_s": 1 / statistics.median(drawing),
        "picture_ms": 1e3 * statistics.median(drawing),
        "action_ms": 1e3 * statistics.median(acting),
        "made_ms": 1e3 * made,
    }
