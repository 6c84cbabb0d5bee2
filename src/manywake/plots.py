"""Every picture: learning curve of a run, wake uncontrolled against controlled with drag and lift beneath."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import scipy.sparse as sp
import skfem
from matplotlib.tri import Triangulation
from scipy.sparse.linalg import spsolve

from manywake.flow.baseline import Baseline
from manywake.flow.batch import FlowBatch, Start
from manywake.flow.case import Case
from manywake.flow.operators import Operators
from manywake.flow.space import Space
from manywake.learn.evaluate import Evaluation

UNCONTROLLED, CONTROLLED, REFERENCE = "#c44e52", "#2f6c9f", "#555555"

plt.rcParams.update(
    {"figure.dpi": 110, "font.size": 10, "axes.spines.top": False, "axes.spines.right": False, "legend.frameon": False}
)


def learning_curve(episodes: dict[str, np.ndarray], base: Baseline, path: Path) -> None:
    """Draw C_D and C_L of the exploring episodes against episodes and wall time; `episodes` as in episodes.csv."""
    figure, axes = plt.subplots(2, 2, figsize=(10, 5.6), sharey="row")
    batch = [episodes["update"] == update for update in np.unique(episodes["update"])]
    for column, (x, label) in enumerate(
        ((episodes["episode"] + 1, "episodes"), (episodes["wall_s"] / 60, "wall time [min]"))
    ):
        for row, (name, title) in enumerate((("c_d_second_half", "$C_D$"), ("c_l_second_half", "$C_L$"))):
            axis = axes[row, column]
            axis.plot(x, episodes[name], ".", color=CONTROLLED, alpha=0.25, markersize=4, label="an episode")
            means = [np.nanmean(episodes[name][rows]) for rows in batch]
            axis.plot([x[rows].max() for rows in batch], means, color=CONTROLLED, lw=2, label="mean of an update")
            axis.set_ylabel(f"{title}, 2nd half of episode")
            axis.set_xlabel(label)
            axis.grid(alpha=0.25)
        axes[0, column].axhline(base.shedding.cd_mean, color=UNCONTROLLED, lw=1, label="uncontrolled mean")
        axes[0, column].axhline(base.cd_steady, color=REFERENCE, lw=1, ls="--", label="steady base flow")
        axes[1, column].axhline(0.0, color=REFERENCE, lw=1, ls="--")
    axes[0, 1].legend(loc="upper right", fontsize=9, frameon=True, framealpha=1.0, edgecolor="none")
    figure.suptitle("Learning curve (exploring policy)", x=0.01, ha="left")
    figure.tight_layout()
    figure.savefig(path)
    plt.close(figure)


def vorticity(space: Space, u: np.ndarray) -> np.ndarray:
    """Return the vorticity dv/dx - du/dy at the mesh's vertices (m,), projected onto P1; u: (n, 2)."""
    ux, vx = (space.velocity.interpolate(u[:, c]) for c in range(2))
    load = skfem.LinearForm(lambda q, w: (w.v.grad[0] - w.u.grad[1]) * q).assemble(space.pressure, u=ux, v=vx)
    mass = skfem.BilinearForm(lambda p, q, w: p * q).assemble(space.pressure)
    return spsolve(sp.csc_matrix(mass), load)


def _draw_vorticity(axis, case: Case, space: Space, u: np.ndarray, limit: float):
    points = space.mesh.points
    mesh = Triangulation(points[:, 0], points[:, 1], space.mesh.triangles)
    picture = axis.tripcolor(
        mesh, vorticity(space, u), shading="gouraud", cmap="RdBu_r", vmin=-limit, vmax=limit, rasterized=True
    )
    axis.add_patch(plt.Circle((0, 0), case.radius, color="#888888", lw=0))
    axis.set_aspect("equal")
    axis.set_xlim(case.x_range[0], 1.6)
    axis.set_ylim(*case.y_range)
    axis.set_xlabel("x")
    return picture


def _one_period(ops: Operators, base: Baseline) -> np.ndarray:
    """Return C_D and C_L (steps, 2) of the uncontrolled flow over one period from the start state."""
    steps = int(np.ceil(base.shedding.period / ops.case.time_step)) + 1
    return FlowBatch(ops, base.start, 1).advance(np.zeros((steps, len(ops.case.jets), 1)))[:, :, 0]


def wake(ops: Operators, base: Baseline, evaluation: Evaluation, max_flow_rate: float, path: Path) -> None:
    """Draw the wake uncontrolled and controlled, and C_D, C_L and the jet over the long run from the start state."""
    case, trajectory = ops.case, evaluation.trajectory
    time = (np.arange(len(trajectory.c_d)) + 1) * case.time_step
    period = _one_period(ops, base)
    phase = np.mod(time, base.shedding.period) / case.time_step - 1
    free = [np.interp(phase, np.arange(len(period)), period[:, c]) for c in range(2)]
    figure = plt.figure(figsize=(11, 6.6))
    grid = figure.add_gridspec(3, 2, height_ratios=(1.05, 1, 1), hspace=0.55, wspace=0.18)
    pictures: list[tuple[str, Start]] = [("uncontrolled", base.start), ("controlled", trajectory.ends[0])]
    for column, (name, state) in enumerate(pictures):
        axis = figure.add_subplot(grid[0, column])
        picture = _draw_vorticity(axis, case, ops.space, state.u, 30.0)
        axis.set_title(name, loc="left", color=(UNCONTROLLED, CONTROLLED)[column])
        if column == 0:
            axis.set_ylabel("y")
    figure.colorbar(
        picture, ax=figure.axes, shrink=0.75, pad=0.015, label=r"vorticity [$\bar U$ / 10 D]", extend="both"
    )
    series = ((free[0], trajectory.c_d[:, 0], "$C_D$"), (free[1], trajectory.c_l[:, 0], "$C_L$"))
    drag, lift = figure.add_subplot(grid[1, :]), figure.add_subplot(grid[2, :])
    for axis, (uncontrolled, controlled, label) in zip((drag, lift), series, strict=True):
        axis.plot(time, uncontrolled, color=UNCONTROLLED, lw=0.8, alpha=0.7, label="uncontrolled")
        axis.plot(time, controlled, color=CONTROLLED, lw=1.2, label="controlled")
        axis.set_ylabel(label)
        axis.grid(alpha=0.25)
        axis.set_xlim(0, time[-1])
    drag.axhline(base.cd_steady, color=REFERENCE, lw=1, ls="--", label="steady base flow")
    low = min(base.cd_steady, np.nanmin(trajectory.c_d[:, 0]))
    drag.set_ylim(low - 0.03, max(free[0].max(), np.nanmax(trajectory.c_d[:, 0])) + 0.12)
    drag.legend(ncols=3, loc="upper right", fontsize=9)
    drag.set_xticklabels([])
    lift.set_xlabel(r"time [10 D/$\bar U$, the paper's unit]")
    jets = lift.twinx()
    jets.plot(time, trajectory.jets[:, 0] / max_flow_rate, color="#7a9a4b", lw=0.8)
    jets.set_ylim(-1.05, 1.05)
    jets.set_ylabel("$Q_1 / Q_{max}$", color="#7a9a4b")
    jets.spines["right"].set_visible(True)
    figure.savefig(path, bbox_inches="tight")
    plt.close(figure)
