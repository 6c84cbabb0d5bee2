"""Learning with and without a penalty of the lift (the paper's appendix B, figure 7).

Claim: without the penalty the policy finds a biased jet: less drag, but an asymmetric wake and a large mean lift.
Here: speed averaged over about ten shedding periods, after one episode: without control; with the policy of `synced`,
seed 0 (reward of eq. 1); with one trained on the drag alone and with jets of twice the flow rate. Those need half the
time step: at 5e-4 steady blowing of 0.0175 blows the explicit scheme up, at 2.5e-4 0.025 does not.
Command: manywake figure cheating
Cost: 1 training of 240 episodes of twice the steps, 3 min on both cores, the start state at the smaller step, 1 min,
and three flows of 10 000 to 20 000 steps.
Expected: mean C_L near 0 but for the last, where it is of the order of 1 or 2 (steady blowing of -0.012 alone has C_D
2.92 and C_L 3.7).
"""

from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from experiments import learning_curves, policies_in_lanes, synced, trainings, vertex_maps
from experiments.experiment import Setup, read, rounded, where, write
from experiments.trainings import CASE, Training
from manywake.env.control import ControlledFlows
from manywake.flow import store
from manywake.learn import checkpoints
from manywake.learn.runs import Run

BY_PROTOCOL = True
EPISODES = 240
STRONG_STEP, STRONG_RATE = 2.5e-4, 0.02
PERIODS = 10
LABELS = {
    "none": "no control",
    "penalty": "trained with lift penalty",
    "no penalty": f"trained without lift penalty, jets up to {STRONG_RATE:g}",
}


def wanted(setup: Setup) -> dict[str, list[Training]]:
    strong: dict[str, Any] = {"reward": "drag-offset"}
    if not setup.miniature:  # which has a start state of its own
        strong |= {"limit": STRONG_RATE, "time_step": STRONG_STEP}
    biased = trainings.by_protocol(setup, "cheating", "no penalty", 0, EPISODES, **strong)
    return {"penalty": synced.group(setup)["20"][:1], "no penalty": [biased]}


def run(setup: Setup) -> None:
    sets = trainings.trained(setup, wanted(setup))
    (penalised,), (biased,) = sets["penalty"], sets["no penalty"]
    maps, numbers = {}, []
    for name, run, controlled in (
        ("none", penalised, False),
        ("penalty", penalised, True),
        ("no penalty", biased, True),
    ):
        setup.progress(f"cheating: {LABELS[name]}", 0.0)
        maps[name.replace(" ", "_")], row = _averaged(run, controlled, 0.1 if setup.miniature else PERIODS)
        numbers.append(rounded({"series": name, **row}, 5))
        setup.progress(f"cheating: {LABELS[name]}", 1.0)
    write(setup.csv("cheating"), vertex_maps.rows(store.get(CASE).mesh, **maps))
    write(setup.csv("cheating-numbers"), numbers)


def _averaged(run: Run, controlled: bool, periods: float) -> tuple[np.ndarray, dict[str, float]]:
    """Return the mean speed at the vertices after one episode's transient, and the means of the forces and the jet."""
    simulation = trainings.opened(run)
    flow, task, settle = simulation.flows[0], simulation.task, simulation.horizon
    actions = round(periods * flow.baseline.statistics.period / task.interval)
    speeds: list[np.ndarray] = []

    def look(flows: ControlledFlows) -> None:
        speeds.append(np.linalg.norm(flows.batch.state(0).u[: len(flow.baseline.mesh.points)], axis=1))

    policy = checkpoints.policy(run) if controlled else None
    series = policies_in_lanes.play(flow, task, [policy], settle + actions, look)
    c_d, c_l, jet = (part[settle * task.steps(flow.case.dt) :, 0] for part in series.values())
    return np.mean(speeds[settle:], axis=0), {
        "c_d": c_d.mean(),
        "c_l": c_l.mean(),
        "jet": jet.mean(),
        "jet_max": abs(jet).max(),
    }


def plot(setup: Setup) -> None:
    table, numbers = read(setup.csv("cheating")), read(setup.csv("cheating-numbers"))
    figure, axes = plt.subplots(3, 1, figsize=(10, 6.6), sharex=True, layout="constrained")
    highest = max(np.nanmax(table[name.replace(" ", "_")]) for name in LABELS)
    for axis, (name, label) in zip(axes, LABELS.items(), strict=True):
        style = {"cmap": "magma", "vmin": 0.0, "vmax": highest}
        picture = vertex_maps.draw(axis, CASE, table, name.replace(" ", "_"), **style)
        row = {key: column[0] for key, column in where(numbers, series=name).items()}
        text = f"{label}: mean $C_D$ {row['c_d']:.3f}, mean $C_L$ {row['c_l']:+.3f}, mean jet {row['jet']:+.4f}"
        axis.set_title(text, fontsize=10, loc="left")
    figure.colorbar(picture, ax=axes, label=r"speed [$\bar U$]", pad=0.015, shrink=0.6)
    axes[-1].set_xlabel("x [10 D]")
    title = f"Speed averaged over {PERIODS} shedding periods"
    learning_curves.save(figure, setup.png("cheating"), title)


def summary(setup: Setup) -> dict:
    numbers = read(setup.csv("cheating-numbers"))
    return {name: {k: float(v[0]) for k, v in where(numbers, series=name).items() if k != "series"} for name in LABELS}
