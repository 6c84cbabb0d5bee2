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

from manywake.case.case import Case
from manywake.case.geometry import outline
from manywake.flow import spinup
from manywake.flow.baseline import Baseline
from manywake.flow.batch import FlowBatch, Start
from manywake.flow.space import Space
from manywake.flow.store import Flow

UNCONTROLLED, CONTROLLED, REFERENCE, AMPLITUDE = "#c44e52", "#2f6c9f", "#555555", "#7a9a4b"

plt.rcParams.update(
    {"figure.dpi": 110, "font.size": 10, "axes.spines.top": False, "axes.spines.right": False, "legend.frameon": False}
)


def _shown(base: Baseline) -> tuple[tuple[str, str], tuple[str, str]]:
    """Return the two readings that are drawn, with labels: drag and lift, or what else the case measures."""
    if "c_d" in base.free:
        return ("c_d", "$C_D$"), ("c_l", "$C_L$")
    first, *others = [name for name in base.steady if name != "power"][::-1] or ["power"]
    second = others[0] if others else first
    return (first, first), (second, second)


def learning_curve(episodes: dict[str, np.ndarray], base: Baseline, path: Path) -> None:
    """Draw two readings of the exploring episodes against episodes and wall time; `episodes` as in episodes.csv."""
    figure, axes = plt.subplots(2, 2, figsize=(10, 5.6), sharey="row")
    batch = [episodes["update"] == update for update in np.unique(episodes["update"])]
    along = (episodes["episode"] + 1, "episodes"), (episodes["wall_s"] / 60, "wall time [min]")
    for column, (x, label) in enumerate(along):
        for row, (name, title) in enumerate(_shown(base)):
            axis, half = axes[row, column], episodes[f"{name}_second_half"]
            axis.plot(x, half, ".", color=CONTROLLED, alpha=0.25, markersize=4, label="an episode")
            means = [np.nanmean(half[rows]) for rows in batch]
            axis.plot([x[rows].max() for rows in batch], means, color=CONTROLLED, lw=2, label="mean of an update")
            axis.set(xlabel=label, ylabel=f"{title}, 2nd half of episode")
            axis.grid(alpha=0.25)
        first = _shown(base)[0][0]
        axes[0, column].axhline(base.free[first], color=UNCONTROLLED, lw=1, label="uncontrolled mean")
        axes[0, column].axhline(base.steady[first], color=REFERENCE, lw=1, ls="--", label="steady base flow")
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


def _draw_vorticity(axis, case: Case, space: Space, u: np.ndarray):
    points, values = space.mesh.points, vorticity(space, u) * case.convective_time
    mesh = Triangulation(points[:, 0], points[:, 1], space.mesh.triangles)
    picture = axis.tripcolor(mesh, values, shading="gouraud", cmap="RdBu_r", vmin=-3, vmax=3, rasterized=True)
    for body in case.bodies:
        axis.add_patch(plt.Polygon(outline(body), color="#888888", lw=0))
    (left, low), (right, high) = points.min(axis=0), points.max(axis=0)
    back = max((outline(body)[:, 0].max() for body in case.bodies), default=left)
    axis.set(xlim=(left, min(right, back + 15.5 * case.scales.length)), ylim=(low, high), xlabel="x", aspect="equal")
    return picture


def wake(flow: Flow, end: Start, series: dict[str, np.ndarray], amplitudes: np.ndarray, path: Path) -> None:
    """Draw the flow uncontrolled and controlled, two readings and an amplitude over a long run from the start state.

    end: the controlled flow at the end of the run. series: its readings (steps,). amplitudes: (steps, inputs).
    """
    case, base, space = flow.case, flow.baseline, flow.operators.space
    uncontrolled = spinup.free_run(FlowBatch(flow.operators, base.start, 1), len(amplitudes))
    time = (np.arange(len(amplitudes)) + 1) * case.dt
    free = {name: uncontrolled[name][:, 0] for name, _ in _shown(base)}
    time = time / case.convective_time
    figure = plt.figure(figsize=(11, 6.6))
    grid = figure.add_gridspec(3, 2, height_ratios=(1.05, 1, 1), hspace=0.55, wspace=0.18)
    pictures = ("uncontrolled", UNCONTROLLED, base.start.u), ("controlled", CONTROLLED, end.u)
    for column, (name, color, u) in enumerate(pictures):
        axis = figure.add_subplot(grid[0, column], ylabel="" if column else "y")
        picture = _draw_vorticity(axis, case, space, u)
        axis.set_title(name, loc="left", color=color)
    figure.colorbar(picture, ax=figure.axes, shrink=0.75, pad=0.015, label="vorticity [U/L]", extend="both")
    drag, lift = figure.add_subplot(grid[1, :]), figure.add_subplot(grid[2, :])
    for axis, (name, label) in zip((drag, lift), _shown(base), strict=True):
        axis.plot(time, free[name], color=UNCONTROLLED, lw=0.8, alpha=0.7, label="uncontrolled")
        axis.plot(time, series[name], color=CONTROLLED, lw=1.2, label="controlled")
        axis.set(xlim=(0, time[-1]), ylabel=label)
        axis.grid(alpha=0.25)
    first, _ = _shown(base)[0]
    drag.axhline(base.steady[first], color=REFERENCE, lw=1, ls="--", label="steady base flow")
    low, high = min(base.steady[first], np.nanmin(series[first])), max(free[first].max(), np.nanmax(series[first]))
    drag.set(ylim=(low - 0.03, high + 0.12), xticklabels=[])
    drag.legend(ncols=3, loc="upper right", fontsize=9)
    lift.set_xlabel("time [L/U]")
    driven, right = case.actuators[0], lift.twinx()
    right.plot(time, amplitudes[:, 0] / driven.limit, color=AMPLITUDE, lw=0.8)
    right.set_ylim(-1.05, 1.05)
    right.set_ylabel(f"{driven.on} / limit", color=AMPLITUDE)
    right.spines["right"].set_visible(True)
    figure.savefig(path, bbox_inches="tight")
    plt.close(figure)
