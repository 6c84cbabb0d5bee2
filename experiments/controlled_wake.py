"""The controlled wake: forces, jets, recirculation and spectra, as the 2019 papers report them.

Claim: C_D falls from 3.205 to about 2.95, 93 % of the drag that shedding adds to the steady base flow, with jets at
about 0.5 % of the flow through the cylinder's height; the recirculation area grows by 130 %.
Here: three seeds with the default settings of `manywake train` (their policies hold beyond an episode), deterministic,
four episode lengths from the start state; statistics of the second half. The same policies on a mesh whose triangles
are each cut into four, at half the time step: the loss of drag reduction is to be at most 0.5 points.
Command: manywake figure controlled-wake
Cost: 3 trainings of 256 episodes, 5 min; the long runs, 20 s, and those on the fine mesh, 4 min.
Expected: 7.7 to 7.9 % less drag, 97 to 99 % of what shedding adds, no peak left at St 0.30, loss below 0.5 points.
"""

from collections.abc import Callable
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

from experiments import learning_curves, policies_in_lanes, trainings
from experiments.experiment import Setup, Table, read, rounded, spread, where, write
from experiments.learning_curves import COLOURS
from experiments.trainings import Training
from manywake import plots
from manywake.case.case import Case
from manywake.env.control import ControlledFlows
from manywake.flow import baseline, forced, mesh, problem, readings, space
from manywake.flow.store import Flow
from manywake.learn import checkpoints
from manywake.learn.evaluate import LONG_RUN
from manywake.suite import load
from manywake.suite.cylinder_jets import LEARNING

THROUGH_HEIGHT = 0.14694
"""Flow rate of the inflow through the cylinder's frontal height."""
SHOWN = 8.0
"""Time of the series that are kept and drawn."""
HIGHEST = 1.0
"""Strouhal number up to which spectra are kept."""


def wanted(setup: Setup) -> dict[str, list[Training]]:
    how = {"protocol": "default", "case": load.DEFAULT}
    return trainings.seeded(setup, "controlled-wake", LEARNING.episodes, {"default": how})


def run(setup: Setup) -> None:
    group = trainings.trained(setup, wanted(setup))["default"]
    played = trainings.opened(group[0])
    driving = {"uncontrolled": None} | {f"seed {run.settings.seed}": checkpoints.policy(run) for run in group}
    numbers, series, spectra = [], [], []
    trained_on = played.flows[0]
    for grid, flow in (("training", trained_on), ("fine", trained_on if setup.miniature else finer(trained_on))):
        actions, areas = LONG_RUN * played.horizon, []

        def look(flows: ControlledFlows, areas=areas, grid=grid, actions=actions) -> None:
            u = [flows.batch.state(column).u for column in range(flows.count)]
            areas.append([readings.recirculation_area(flows.flow.operators.space, one) for one in u])
            setup.progress(f"controlled-wake: long runs, {grid} mesh", len(areas) / actions)

        result = policies_in_lanes.play(flow, played.task, list(driving.values()), actions, look)
        for column, name in enumerate(driving):
            mine = {key: part[:, column] for key, part in (result | {"area": np.array(areas)}).items()}
            numbers.append(rounded({"series": name, "mesh": grid, **_numbers(flow, mine)}, 5))
            if grid == "training":
                series += _series(flow.case.dt, mine, name)
                spectra += _spectrum(flow.case, mine, name)
    write(setup.csv("controlled-wake"), series)
    write(setup.csv("controlled-wake-spectra"), spectra)
    write(setup.csv("controlled-wake-numbers"), numbers)


def finer(coarse: Flow) -> Flow:
    """Return the flow on the refined mesh at half the time step, from the interpolated start state."""
    ops, base = coarse.operators, coarse.baseline
    case = replace(coarse.case, time_step=coarse.case.dt / 2)
    posed = problem.pose(case, mesh.refine(base.mesh))
    onto, _ = space.carrying(ops.space, posed.space)
    mean, fluctuation = (onto @ part for part in base.advecting)
    fine = baseline.assemble(case, posed, mean, fluctuation)
    starts = (forced.interpolate(ops.space, base.start, fine),)
    return Flow(case, fine, replace(base, mesh=posed.space.mesh, starts=starts, mean=mean, fluctuation=fluctuation))


def _numbers(flow: Flow, mine: dict[str, np.ndarray]) -> dict[str, float]:
    """Return the statistics of one flow's second half; mine: c_d, c_l and jet of every step, area of every action."""
    c_d, c_l, jet, area = (mine[name][len(mine[name]) // 2 :] for name in ("c_d", "c_l", "jet", "area"))
    return {
        "c_d": c_d.mean(),
        "c_l": c_l.mean(),
        "c_l_rms": np.sqrt(np.mean(c_l**2)),
        "jet_over_inflow": abs(jet).mean() / THROUGH_HEIGHT,
        "jet_rms": np.sqrt(np.mean(jet**2)) / flow.case.actuators[0].limit,
        "area": area.mean(),
        "c_d_steady": flow.baseline.steady["c_d"],
    }


def _series(dt: float, mine: dict[str, np.ndarray], name: str) -> list[dict]:
    """Return rows at the middle and the end of every action; the area is known at its end."""
    half = len(mine["c_d"]) // len(mine["area"]) // 2
    picked = [k for k in range(half - 1, len(mine["c_d"]), half) if (k + 1) * dt <= SHOWN + 1e-9]
    columns: dict[str, Callable[[int], float]] = {
        "time": lambda k: (k + 1) * dt,
        "c_d": lambda k: mine["c_d"][k],
        "c_l": lambda k: mine["c_l"][k],
        "jet": lambda k: 1e3 * mine["jet"][k],
        "area": lambda k: mine["area"][min((k + 1) // (2 * half), len(mine["area"])) - 1] if k >= half else np.nan,
    }
    return [{"series": name} | rounded({key: float(get(k)) for key, get in columns.items()}) for k in picked]


def _spectrum(case: Case, mine: dict[str, np.ndarray], name: str) -> list[dict]:
    """Return the amplitudes of C_L and the jet in the second half, Hann window, against the Strouhal number."""
    half = len(mine["c_l"]) // 2
    window = np.hanning(half)
    strouhal = np.fft.rfftfreq(half, case.dt) * case.convective_time
    parts = [series[-half:] - series[-half:].mean() for series in (mine["c_l"], 1e3 * mine["jet"])]
    c_l, jet = (2 * abs(np.fft.rfft(window * part)) / window.sum() for part in parts)
    kept = np.flatnonzero(strouhal <= HIGHEST)
    columns = {"strouhal": strouhal, "c_l": c_l, "jet": jet}
    return [{"series": name} | rounded({key: float(x[k]) for key, x in columns.items()}, 6) for k in kept]


def plot(setup: Setup) -> None:
    series, spectra = read(setup.csv("controlled-wake")), read(setup.csv("controlled-wake-spectra"))
    figure, axes = plt.subplots(3, 2, figsize=(13, 8.5))
    names = ("uncontrolled", *(f"seed {seed}" for seed in trainings.seeds(setup)))
    colours = dict(zip(names, (plots.REFERENCE, *COLOURS), strict=False))
    panels = (("c_d", "$C_D$"), ("c_l", "$C_L$"), ("jet", "$Q_1$ [$10^{-3}$]"), ("area", "recirculation area [100 D²]"))
    for axis, (name, label) in zip(axes.T.ravel(), panels, strict=False):
        for which, colour in colours.items():
            mine = where(series, series=which)
            style = {"lw": 0.7, "alpha": 0.7} if which == "uncontrolled" else {"lw": 1.2}
            axis.plot(mine["time"], mine[name], color=colour, label=which, **style)
        learning_curves.finish(axis, r"time [10 D/$\bar U$]", label)
    numbers = read(setup.csv("controlled-wake-numbers"))
    axes[0, 0].axhline(numbers["c_d_steady"][0], color="black", lw=1, ls="--", label="steady flow")
    for which, colour in colours.items():
        mine = where(spectra, series=which)
        axes[1, 1].semilogy(mine["strouhal"], mine["c_l"], color=colour)
    learning_curves.finish(axes[1, 1], "Strouhal number", "amplitude of $C_L$, 2nd half")
    axes[1, 1].set_ylim(bottom=1e-5)
    _plot_meshes(axes[2, 1], numbers, [name for name in names if name != "uncontrolled"], colours)
    handles, texts = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, texts, ncols=len(texts), loc="lower center", fontsize=9)
    learning_curves.save(
        figure, setup.png("controlled-wake"), "The controlled wake, deterministic policies", below=0.04
    )


def _plot_meshes(axis, numbers: Table, names: list[str], colours: dict[str, str]) -> None:
    for mark, grid in (("o", "training"), ("s", "fine")):
        values = [100 * reduction(numbers, name, grid) for name in names]
        axis.scatter(range(len(names)), values, 60, [colours[name] for name in names], marker=mark)
        axis.plot([], [], mark, color=plots.REFERENCE, label=f"{grid} mesh")
    free = _row(numbers, "uncontrolled", "training")
    axis.axhline(100 * (1 - free["c_d_steady"] / free["c_d"]), color="black", lw=1, ls="--", label="steady flow")
    axis.set_xticks(range(len(names)), names)
    axis.margins(x=0.3, y=0.4)
    axis.legend(fontsize=9, ncols=3, loc="upper center")
    axis.set_ylabel("drag reduction [%]")
    axis.grid(alpha=0.25, axis="y")


def _row(numbers: Table, name: str, grid: str) -> dict[str, float]:
    mine = where(numbers, series=name, mesh=grid)
    return {key: float(column[0]) for key, column in mine.items() if key not in ("series", "mesh")}


def reduction(numbers: Table, name: str, grid: str) -> float:
    """Return the drag reduction against the uncontrolled flow of the same mesh."""
    return 1 - _row(numbers, name, grid)["c_d"] / _row(numbers, "uncontrolled", grid)["c_d"]


def summary(setup: Setup) -> dict:
    numbers = read(setup.csv("controlled-wake-numbers"))
    free = _row(numbers, "uncontrolled", "training")
    names = [f"seed {seed}" for seed in trainings.seeds(setup)]
    rows = [_row(numbers, name, "training") for name in names]
    losses = [100 * (reduction(numbers, name, "training") - reduction(numbers, name, "fine")) for name in names]
    shed = free["c_d"] - free["c_d_steady"]
    return {
        "c_d_uncontrolled": free["c_d"],
        "c_d": spread(row["c_d"] for row in rows),
        "reduction": spread(reduction(numbers, name, "training") for name in names),
        "share_of_shedding_drag": spread((free["c_d"] - row["c_d"]) / shed for row in rows),
        "c_l": [row["c_l"] for row in rows],
        "c_l_rms": spread(row["c_l_rms"] for row in rows),
        "jet_over_inflow": spread(row["jet_over_inflow"] for row in rows),
        "area_uncontrolled": free["area"],
        "area_growth": spread(row["area"] / free["area"] - 1 for row in rows),
        "reduction_fine": spread(reduction(numbers, name, "fine") for name in names),
        "loss_on_fine_mesh_points": losses,
        "loss_at_most_half_a_point": max(losses) <= 0.5,
    }
