"""What every contestant shares: mesh, start state, jets, clock, statistics. NumPy only, for any Python from 3.9 on.

Whoever imports this gets one thread.

Parameters are the paper's, in its code's units (D = 0.1, mean inflow 1, density 1).
"""

import argparse
import json
import math
import os
import sys
import time
from pathlib import Path

for library in ("OMP", "OPENBLAS", "MKL"):
    os.environ[library + "_NUM_THREADS"] = "1"  # read when NumPy is imported: so import this module first

import numpy as np  # noqa: E402

RADIUS, VISCOSITY, TIME_STEP = 0.05, 1e-3, 5e-4
Y_LOW, Y_HIGH = -0.2, 0.21
TO_COEFFICIENT = 20.0
"""C = 2 F / (rho U^2 D)."""
JET_ANGLES, JET_WIDTH, MAX_FLOW_RATE = (90.0, 270.0), 10.0, 0.01
STEPS_PER_ACTION, ALPHA = 50, 0.1
MESH = Path(__file__).with_name("peers.npz")


def load() -> dict:
    """Return points, triangles, boundary_*, probes, start_u (in the order of `nodes`), start_p."""
    with np.load(MESH) as data:
        return {name: data[name] for name in data.files}


def nodes(points, triangles):
    """Return the nodes of quadratic elements: vertices, then the middles of the edges in the order of np.unique."""
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    return np.concatenate([points, points[np.unique(edges, axis=0)].mean(axis=1)])


def match(x, wanted):
    """Return where in x (n, 2) the points `wanted` (n, 2) are: x[match(x, wanted)] equals wanted."""
    direction = np.array([1.0, math.sqrt(0.5)])
    place = np.empty(len(x), np.int64)
    place[np.argsort(wanted @ direction)] = np.argsort(x @ direction)
    if not np.allclose(x[place], wanted, rtol=0, atol=1e-10):
        raise ValueError("match: the two sets of points differ; is peers.npz of this mesh?")
    return place


def inflow(y):
    """Return the parabola of mean 1."""
    return 6.0 * (y - Y_LOW) * (Y_HIGH - y) / (Y_HIGH - Y_LOW) ** 2


def jet_profiles(x):
    """Return the velocity at points x (k, 2) of every jet at unit flow rate, (jets, k, 2), as the released code has it.

    Zero outside a jet's arc, but meant for nodes on the cylinder only.
    """
    angle = np.arctan2(x[:, 1], x[:, 0])
    width = math.radians(JET_WIDTH)
    profiles = []
    for centre in JET_ANGLES:
        off = np.angle(np.exp(1j * (angle - math.radians(centre))))
        size = np.pi / (2 * width * RADIUS**2) * np.cos(np.pi * off / width)
        profiles.append(np.where(abs(off) <= width / 2 + 1e-9, size, 0.0)[:, None] * x)
    return np.array(profiles)


def flow_rates(steps: int, off: bool = False):
    """Return the first jet's flow rate at each step (the second's is its negative): smoothed random actions."""
    actions = np.random.default_rng(0).uniform(-MAX_FLOW_RATE, MAX_FLOW_RATE, steps // STEPS_PER_ACTION + 1)
    series, now = np.zeros(steps), 0.0
    for k in range(0 if not off else steps, steps):
        now += ALPHA * (actions[k // STEPS_PER_ACTION] - now)
        series[k] = now
    return series


class Clock:
    """Wall and processor time of blocks of steps, in milliseconds a step."""

    def __init__(self):
        self.wall, self.cpu = [], []

    def run(self, work, steps: int) -> None:
        """Call work() and book its time over `steps`."""
        wall, cpu = time.perf_counter(), time.process_time()
        work()
        self.cpu.append((time.process_time() - cpu) * 1e3 / steps)
        self.wall.append((time.perf_counter() - wall) * 1e3 / steps)


def simulate(step, steps: int, warm: int, block: int = 10) -> dict:
    """Time `steps` environment steps after `warm` untimed ones, in blocks; step(Q) returns C_D, C_L, probes."""
    rates = flow_rates(warm + steps)
    for k in range(warm):
        last = step(rates[k])
    clock = Clock()
    state = {"k": warm, "last": None}

    def some():
        for _ in range(block):
            state["last"] = step(rates[state["k"]])
            state["k"] += 1

    for _ in range(steps // block):
        clock.run(some, block)
    last = state["last"]
    found = {"steps": state["k"], "c_d": float(last[0]), "c_l": float(last[1]), "probes": float(np.sum(last[2]))}
    if not np.isfinite(found["c_d"]):
        raise RuntimeError("the flow has blown up")
    return {"wall_ms": clock.wall, "cpu_ms": clock.cpu, "state_after": found}


def statistics(step, steps: int, transient: int) -> dict:
    """Return mean C_D, C_L max and St of the uncontrolled flow over whole periods of what follows the transient."""
    record = []
    for k in range(transient + steps):
        record.append(step(0.0)[:2])
        if k % 500 == 0:
            print(k, *record[-1], file=sys.stderr, flush=True)
    c_d, c_l = np.array(record[transient:]).T
    level = 0.5 * (c_l.max() + c_l.min())
    up = np.flatnonzero((c_l[:-1] < level) & (c_l[1:] >= level))
    crossing = up + (level - c_l[up]) / (c_l[up + 1] - c_l[up])
    period = (crossing[-1] - crossing[0]) / (len(up) - 1) * TIME_STEP
    whole = slice(up[0] + 1, up[-1] + 1)
    return {
        "cd_mean": float(c_d[whole].mean()),
        "cl_max": float(c_l[whole].max()),
        "strouhal": 0.1 / float(period),
        "cd_max": float(c_d[whole].max()),
        "cl_min": float(c_l[whole].min()),
        "periods": len(up) - 1,
        "transient_steps": transient,
    }


def arguments(description: str) -> argparse.ArgumentParser:
    """Return a parser of what every contestant can be told."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--steps", type=int, default=60)
    parser.add_argument("--warm", type=int, default=20)
    parser.add_argument("--statistics", type=int, nargs="?", const=3400, help="steps after the transient")
    parser.add_argument("--transient", type=int, default=700)
    return parser


def finish(result: dict) -> None:
    """Print the result as the last line."""
    print(json.dumps(result), flush=True)
