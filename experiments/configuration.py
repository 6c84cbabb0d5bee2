"""The configuration (the paper's figure 1): pressure wake without control, probes, jets.

Claim: none to check but the layout: a cylinder a little below the middle of the channel, 151 pressure probes around it
and in its wake, a jet of 10 degrees at its top and one at its bottom.
Here: the start state of every episode, a developed Karman street at an upward crossing of C_L.
Command: manywake figure configuration
Cost: seconds.
"""

import matplotlib.pyplot as plt
import numpy as np

from experiments import learning_curves, vertex_maps
from experiments.experiment import Setup, read, write
from experiments.trainings import CASE
from manywake.flow import store

(CYLINDER,) = CASE.bodies
PROBES = CASE.sensors[0].points


def run(setup: Setup) -> None:
    base = store.get(CASE, setup.progress)
    write(setup.csv("configuration"), vertex_maps.rows(base.mesh, pressure=base.start.p))


def plot(setup: Setup) -> None:
    figure, axis = plt.subplots(figsize=(11, 2.9), layout="constrained")
    table = read(setup.csv("configuration"))
    picture = vertex_maps.draw(axis, CASE, table, "pressure", cmap="viridis")
    axis.plot(*np.transpose(PROBES), "k.", ms=3, label=f"{len(PROBES)} probes")
    for start, end in CYLINDER.parts.values():
        axis.plot(*CYLINDER.point(np.linspace(start, end, 9)).T, color="red", lw=4)
    axis.plot([], [], color="red", lw=4, label=f"{len(CYLINDER.parts)} jets")
    axis.set_xlabel("x [10 D]")
    axis.legend(loc="upper right", fontsize=9, frameon=True)
    figure.colorbar(picture, ax=axis, label=r"pressure [$\rho \bar U^2$]", pad=0.015, shrink=0.85)
    learning_curves.save(figure, setup.png("configuration"), "Start state: pressure without control, probes and jets")


def summary(setup: Setup) -> dict:
    pressure = read(setup.csv("configuration"))["pressure"]
    return {
        "probes": len(PROBES),
        "jets_degrees": [((start + end) / 2, float(end - start)) for start, end in CYLINDER.parts.values()],
        "pressure_min": float(pressure.min()),
        "pressure_max": float(pressure.max()),
    }
