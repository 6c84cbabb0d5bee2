"""The configuration (the paper's figure 1): pressure wake without control, probes, jets.

Claim: none to check but the layout: a cylinder a little below the middle of the channel, 151 pressure probes around it
and in its wake, a jet of 10 degrees at its top and one at its bottom.
Here: the start state of every episode, a developed Karman street at an upward crossing of C_L.
Command: manywake figure configuration
Cost: seconds.
"""

import learning_curves
import matplotlib.pyplot as plt
import numpy as np
import vertex_maps
from experiment import Setup, read, write
from trainings import CASE

from manywake.flow import baseline


def run(setup: Setup) -> None:
    base = baseline.get(CASE, setup.progress)
    write(setup.csv("configuration"), vertex_maps.rows(base.mesh, pressure=base.start.p))


def plot(setup: Setup) -> None:
    figure, axis = plt.subplots(figsize=(11, 2.9), layout="constrained")
    table = read(setup.csv("configuration"))
    picture = vertex_maps.draw(axis, CASE, table, "pressure", cmap="viridis")
    axis.plot(*np.transpose(CASE.probes), "k.", ms=3, label=f"{len(CASE.probes)} probes")
    for jet in CASE.jets:
        angles = np.radians(np.linspace(jet.angle - jet.width / 2, jet.angle + jet.width / 2, 9))
        axis.plot(CASE.radius * np.cos(angles), CASE.radius * np.sin(angles), color="red", lw=4)
    axis.plot([], [], color="red", lw=4, label=f"{len(CASE.jets)} jets")
    axis.set_xlabel("x [10 D]")
    axis.legend(loc="upper right", fontsize=9, frameon=True)
    figure.colorbar(picture, ax=axis, label=r"pressure [$\rho \bar U^2$]", pad=0.015, shrink=0.85)
    learning_curves.save(figure, setup.png("configuration"), "Start state: pressure without control, probes and jets")


def summary(setup: Setup) -> dict:
    pressure = read(setup.csv("configuration"))["pressure"]
    return {
        "probes": len(CASE.probes),
        "jets_degrees": [(jet.angle, jet.width) for jet in CASE.jets],
        "pressure_min": float(pressure.min()),
        "pressure_max": float(pressure.max()),
    }
