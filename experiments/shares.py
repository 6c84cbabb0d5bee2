"""Where the time of a training goes, what that allows, and what threads bring to one flow (the paper, section 2.3).

Claim: 99.7 % of the time is spent in the environment, so that N environments can gain a factor of about 300 (Amdahl);
parallelising one simulation gains less than 2; a training takes 24 h on one core.
Here: the shares of `synced` with N = 1, one flow in one lane on one core. And the parts of a step of one flow, with its
sizes, as threaded loops: convection over elements, matrix times vector over rows, and triangular solves, in which only
the two velocity components are independent. That is as far as one flow can be split without changing the method;
nothing of it is used in the solver, whose threads and processes advance different flows.
Command: manywake figure shares
Cost: seconds beside `synced`.
Expected: a larger share of the learner than the paper's, as the flow became some hundred times faster and the learner
did not; two threads gain clearly less than 2 for one flow.
"""

import os
import statistics
import time
from typing import Any

import matplotlib.pyplot as plt
import numba
import numpy as np
import scipy.sparse as sp

from experiments import learning_curves, synced
from experiments.experiment import Setup, Table, read, rounded, where, write
from experiments.learning_curves import COLOURS
from experiments.trainings import CASE
from manywake.flow import space as spaces
from manywake.flow import store
from manywake.learn import tables
from manywake.learn.runs import Run

BY_PROTOCOL = True

PAPER = {"environment": 0.997, "learner": 0.003}
RELEASED_EPISODE = 204.0
"""Seconds of an episode of the released code on such a core: 4000 steps of 51 ms, as measured on that core."""
QUADRATURE = 7


def run(setup: Setup) -> None:
    timed = {name: synced.timed(setup, n) for name, n in (("1", 1), ("20", synced.most(setup)))}
    write(setup.csv("shares"), [row for name, run in timed.items() for row in _shares(name, run)])
    write(setup.csv("shares-threads"), _threads(repeats=3 if setup.miniature else 400))


def _shares(name: str, run: Run) -> list[dict[str, Any]]:
    """Return seconds per episode of each part, of the updates after the first, which also loads compiled code."""
    period = run.settings.learning.update_period
    updates = tables.read(run.folder / "updates.csv")[1:]
    rows = tables.read(run.folder / "episodes.csv")[period : (len(updates) + 1) * period]
    layout = run.layout
    cores = min(layout.workers, os.cpu_count() or 1)

    def total(table, column: str) -> float:
        return sum(float(row[column]) for row in table) / len(rows)

    learner, collecting = total(updates, "learner_s"), total(updates, "collect_s")
    flow, policy = (total(rows, part) for part in ("flow_s", "policy_s"))
    if layout.environments > 1:  # slots share cores, so that their times overlap: what counts is the clock's
        flow, policy = collecting * flow / (flow + policy), collecting * policy / (flow + policy)
    parts = {"flow": flow, "policy": policy, "rest": max(collecting - flow - policy, 0.0), "learner": learner}
    return [
        rounded({"environments": name, "lanes": layout.lanes, "cores": cores, "part": part, "seconds": seconds}, 5)
        for part, seconds in parts.items()
    ]


@numba.njit(parallel=True, cache=True)
def _convection(nodes, u, inverse, value, slope, out):
    """Out[e] = ((u . grad) u, psi) on element e; u (2, n), slope (2, q, 6)."""
    for e in numba.prange(len(nodes)):
        for k in range(6):
            out[0, e, k] = out[1, e, k] = 0.0
        for q in range(len(value)):
            a = b = ax = bx = ay = by = 0.0
            for k in range(6):
                i = nodes[e, k]
                a += value[q, k] * u[0, i]
                b += value[q, k] * u[1, i]
                ax += slope[0, q, k] * u[0, i]
                ay += slope[1, q, k] * u[0, i]
                bx += slope[0, q, k] * u[1, i]
                by += slope[1, q, k] * u[1, i]
            s = inverse[e, 0] * a + inverse[e, 1] * b
            t = inverse[e, 2] * a + inverse[e, 3] * b
            for k in range(6):
                out[0, e, k] += value[q, k] * (s * ax + t * ay)
                out[1, e, k] += value[q, k] * (s * bx + t * by)


@numba.njit(parallel=True, cache=True)
def _product(start, column, data, x, out):
    """Out[c] = A x[c] for both components, rows spread over the threads."""
    for i in numba.prange(len(start) - 1):
        for c in range(len(x)):
            total = 0.0
            for k in range(start[i], start[i + 1]):
                total += data[k] * x[c, column[k]]
            out[c, i] = total


@numba.njit(parallel=True, cache=True)
def _solve(start, column, data, x):
    """Solve L x[c] = x[c] and then L' x[c] = x[c] in place, L with a unit diagonal; one thread a component."""
    for c in numba.prange(len(x)):
        for i in range(len(start) - 1):
            for k in range(start[i], start[i + 1]):
                x[c, i] -= data[k] * x[c, column[k]]
        for i in range(len(start) - 2, -1, -1):
            for k in range(start[i], start[i + 1]):
                x[c, column[k]] -= data[k] * x[c, i]


def _threads(repeats: int) -> list[dict[str, Any]]:
    """Return milliseconds of a step's parts for one flow, by the number of threads, medians of turns."""
    parts = _parts()
    samples: dict[tuple[str, int], list[float]] = {}
    threads = [1, 2][: numba.config.NUMBA_NUM_THREADS]
    for turn in range(repeats + 1):
        for count in threads:
            numba.set_num_threads(count)
            for name, work in parts.items():
                start = time.perf_counter()
                work()
                if turn:  # the first compiles
                    samples.setdefault((name, count), []).append(1e3 * (time.perf_counter() - start))
    numba.set_num_threads(threads[-1])
    return [
        rounded({"part": name, "threads": count, "ms": statistics.median(times)})
        for (name, count), times in samples.items()
    ]


def _parts() -> dict[str, Any]:
    """Return the parts of a step of one flow as functions without arguments."""
    base = store.get(CASE)
    space = spaces.build(base.mesh)
    rng = np.random.default_rng(0)
    n, m = space.mass.shape[0], space.pressure_stiffness.shape[0]
    u, p, out = base.start.u.T.copy(), base.start.p[None].copy(), np.empty((2, n))
    value, slope = rng.standard_normal((QUADRATURE, 6)), rng.standard_normal((2, QUADRATURE, 6))
    on_elements = np.empty((2, *space.nodes.shape))
    gather = sp.csr_matrix(
        (np.ones(space.nodes.size), (space.nodes.ravel(), np.arange(space.nodes.size))), (n, space.nodes.size)
    )
    momentum, poisson = (_lower(sp.csc_matrix(a)) for a in (space.mass + 5e-7 * space.stiffness, _grounded(space)))
    rows = {name: (a.indptr, a.indices, a.data) for name, a in (("gather", gather), ("history", space.mass))}
    gradient = sp.csr_matrix(sp.vstack(space.divergence).T.tocsr()[:n])
    rows["gradient"] = gradient.indptr, gradient.indices, gradient.data
    wide, small = np.zeros((1, gradient.shape[1])), np.empty((1, n))

    def convection() -> None:
        _convection(space.nodes, u, space.inverse, value, slope, on_elements)
        _product(*rows["gather"], on_elements.reshape(2, -1), out)

    def products() -> None:
        for _ in range(2):  # history and gradient; divergence has the gradient's entries
            _product(*rows["history"], u, out)
            _product(*rows["gradient"], wide, small)

    x, y = np.empty((2, n)), np.empty((1, m))

    def velocity() -> None:
        x[:] = u
        _solve(*momentum, x)

    def pressure() -> None:
        y[:] = p
        _solve(*poisson, y)

    return {"convection": convection, "products": products, "velocity solve": velocity, "pressure solve": pressure}


def _grounded(space: spaces.Space) -> sp.csc_matrix:
    return space.pressure_stiffness + 1e-6 * sp.identity(space.pressure_stiffness.shape[0])


def _lower(matrix: sp.csc_matrix) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the rows of the strict lower factor in a fill-reducing order."""
    lu = sp.linalg.splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    lower = sp.csr_matrix(sp.tril(lu.L, -1))
    lower.sort_indices()
    return lower.indptr, lower.indices, lower.data


def split(table: Table, environments: str) -> dict[str, float]:
    """Return the parts' seconds per episode."""
    mine = where(table, environments=float(environments))
    return dict(zip(mine["part"].tolist(), mine["seconds"].tolist(), strict=True))


def plot(setup: Setup) -> None:
    table, threads = read(setup.csv("shares")), read(setup.csv("shares-threads"))
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(14, 4.2))
    ours = split(table, "1")
    bars = {"paper, 1 core": PAPER, "ours, 1 core, 1 lane": ours, "ours, 2 cores, 8 lanes": split(table, "20")}
    colours = {"environment": COLOURS[0], "flow": COLOURS[0], "policy": COLOURS[2], "rest": "#999999"}
    for k, parts in enumerate(bars.values()):
        at = 0.0
        for part, seconds in parts.items():
            share = 100 * seconds / sum(parts.values())
            left.barh(k, share, left=at, color=colours.get(part, COLOURS[1]), height=0.6)
            at += share
    left.set_yticks(range(len(bars)), list(bars))
    for part in ("flow", "policy", "rest", "learner"):
        left.plot([], [], "s", color=colours.get(part, COLOURS[1]), label=part)
    left.legend(ncols=4, fontsize=9, loc="upper center", bbox_to_anchor=(0.5, 1.14))
    left.set_xlabel("share of a training's time [%]")
    n = np.geomspace(1, 1000)
    for colour, (name, learner) in zip(COLOURS, _learners(table).items(), strict=False):
        middle.loglog(n, 1 / (learner + (1 - learner) / n), color=colour, label=f"{name}: at most {1 / learner:.0f}")
    middle.loglog(n, n, color="#555555", lw=1, ls="--")
    middle.legend(fontsize=9)
    learning_curves.finish(middle, "environments", "speed-up by Amdahl's law")
    _plot_threads(right, threads)
    learning_curves.save(figure, setup.png("shares"), "Where the time goes, and what that allows")


def _learners(table: Table) -> dict[str, float]:
    ours = split(table, "1")
    return {"paper": PAPER["learner"], "ours, 1 lane": ours["learner"] / sum(ours.values())}


def _plot_threads(axis, threads: Table) -> None:
    counts = sorted(set(threads["threads"].tolist()))
    bottom = np.zeros(len(counts))
    for colour, part in zip(COLOURS, dict.fromkeys(threads["part"].tolist()), strict=False):
        ms = where(threads, part=part)["ms"]
        axis.bar([f"{count:g}" for count in counts], ms, bottom=bottom, color=colour, label=part, width=0.5)
        bottom += ms
    axis.legend(fontsize=9)
    axis.set_ylim(top=1.5 * bottom.max())
    learning_curves.finish(axis, "threads of one flow", "parts of a step [ms]")


def summary(setup: Setup) -> dict:
    table, threads = read(setup.csv("shares")), read(setup.csv("shares-threads"))
    ours, many = split(table, "1"), split(table, "20")
    one, two = (where(threads, threads=count) for count in (1, threads["threads"].max()))
    by_part = zip(one["part"], one["ms"], two["ms"], strict=True)
    return {
        "environment_share": 1 - _learners(table)["ours, 1 lane"],
        "amdahl_limit": 1 / _learners(table)["ours, 1 lane"],
        "seconds_per_episode_1_lane": sum(ours.values()),
        "seconds_per_episode_20": sum(many.values()),
        "hours_of_400_released_code": 400 * RELEASED_EPISODE / PAPER["environment"] / 3600,
        "minutes_of_400_1_lane": 400 * sum(ours.values()) / 60,
        "minutes_of_400_20": 400 * sum(many.values()) / 60,
        "one_flow_speedup_of_2_threads": float(one["ms"].sum() / two["ms"].sum()),
        "by_part": {part: before / after for part, before, after in by_part},
    }
