"""Every picture: the mesh; the wake with its series; learning curves of one run, of several, and of one under way."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from manywake.case.case import Case
from manywake.case.geometry import Circle, outline
from manywake.case.sensors import Probes
from manywake.env.scene import lines
from manywake.flow.baseline import Baseline
from manywake.flow.batch import Start
from manywake.flow.mesh import Mesh
from manywake.flow.raster import Raster, framed
from manywake.flow.store import Flow
from manywake.machine import disk

UNCONTROLLED, CONTROLLED, REFERENCE = "#d55e00", "#0072b2", "#555555"
COLOURS = "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000"
"""Of the inputs. All colours are those of Okabe and Ito, which colour-blind readers can tell apart."""
GROUPS = CONTROLLED, UNCONTROLLED, *COLOURS
"""Of groups of runs; past these they are shades from dark to light."""
STEADY: dict[str, Any] = {"color": REFERENCE, "lw": 1.0, "ls": "--", "label": "steady flow"}
"""A dashed line is the steady flow, in every picture."""
FREE: dict[str, Any] = {"color": UNCONTROLLED, "lw": 1.0, "label": "uncontrolled, mean"}
LABELS = {"c_d": "$C_D$", "c_l": "$C_L$"}
PIXELS = 1000
"""Of a field, from left to right."""
SLIM = 0.15
"""Least height of a mesh by its width; a longer one is stretched across."""
SETTLED = 0.125
"""Share of a run after which its start does not decide the range of an axis."""

matplotlib.rcParams.update(
    {"figure.dpi": 110, "font.size": 10, "axes.spines.top": False, "axes.spines.right": False, "legend.frameon": False}
)


def _save(figure: Figure, path: Path) -> None:
    disk.write(path, lambda file: figure.savefig(file, format="png"))


def _figure(width: float, height: float, title: str) -> Figure:
    figure = Figure(figsize=(width, height), layout="constrained")
    figure.suptitle(title, x=0.01, ha="left", fontsize=11)
    return figure


def update_means(table: dict[str, np.ndarray], name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return how many episodes there were after each update, and the mean of a column over those of the update.

    table: columns of episodes.csv. The mean is NaN where no episode of an update has a number.
    """
    batches = [table["update"] == update for update in np.unique(table["update"])]
    values = [table[name][rows] for rows in batches]
    means = [np.mean(part[np.isfinite(part)]) if np.isfinite(part).any() else np.nan for part in values]
    return np.array([table["episode"][rows].max() + 1 for rows in batches]), np.array(means)


def _of_episodes(table: dict[str, np.ndarray], name: str) -> tuple[str, str]:
    """Return the column of episodes.csv that is drawn of a reading or the reward, and its label."""
    half = f"{name}_second_half"
    if half in table:
        return half, f"{LABELS.get(name, name)}, 2nd half of episode"
    return name, f"{LABELS.get(name, name)}, {'sum over an episode' if name == 'reward' else 'mean'}"


def learning_curve(episodes: dict[str, np.ndarray], base: Baseline, title: str, path: Path) -> None:
    """Draw readings and reward of the exploring episodes against episodes and wall time.

    episodes: as in episodes.csv.
    """
    names = (*base.shown, "reward")
    figure = _figure(10, 0.9 + 2.6 * len(names), f"{title}: exploring policy")
    axes = figure.subplots(len(names), 2, sharey="row", squeeze=False)
    ends = [np.flatnonzero(episodes["update"] == update)[-1] for update in np.unique(episodes["update"])]
    along = (episodes["episode"] + 1, "episodes"), (episodes["wall_s"] / 60, "wall time [min]")
    for column, (x, label) in enumerate(along):
        for row, name in enumerate(names):
            axis, (y, of) = axes[row, column], _of_episodes(episodes, name)
            axis.plot(x, episodes[y], ".", color=CONTROLLED, alpha=0.3, markersize=5, mew=0, label="an episode")
            axis.plot(x[ends], update_means(episodes, y)[1], color=CONTROLLED, lw=2, label="mean of an update")
            if name in base.free:
                axis.axhline(base.free[name], **FREE)
                axis.axhline(base.steady[name], **STEADY)
            axis.set(xlabel=label if row == len(names) - 1 else "")
            axis.grid(alpha=0.25)
            if not column:
                axis.set_ylabel(of)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), ncols=4, loc="outside lower center", fontsize=9)
    figure.align_ylabels(axes)
    _save(figure, path)


def mesh(case: Case, made: Mesh, title: str, path: Path) -> None:
    """Draw a mesh whole, and around its bodies, with what acts on the flow and what is measured."""
    (left, low), (right, high) = made.points.min(axis=0), made.points.max(axis=0)
    views = [((left, right), (low, high))]
    if case.bodies:
        around = np.concatenate([outline(body) for body in case.bodies])
        (left, low), (right, high), room = around.min(axis=0), around.max(axis=0), 0.5 * case.scales.length
        views.append(((left - room, right + room), (low - room, high + room)))
    heights = [min(max(float(np.ptp(y) / np.ptp(x)), SLIM), 0.7) for x, y in views]
    figure = _figure(11, 10 * sum(heights) + 1.4, title)
    axes = figure.subplots(len(views), 1, height_ratios=heights, squeeze=False)[:, 0]
    for axis, height, (x, y) in zip(axes, heights, views, strict=True):
        axis.triplot(*made.points.T, made.triangles, color=REFERENCE, lw=0.3)
        for body in case.bodies:
            axis.add_patch(Polygon(outline(body), facecolor="#dddddd", edgecolor="black", lw=0.6, zorder=2))
        for k, given in enumerate(case.inputs):
            for n, line in enumerate(lines(case, given)):
                named = {"label": f"{type(given).__name__} {given.on}"} if n == 0 else {}
                axis.plot(*line.T, color=COLOURS[k % len(COLOURS)], lw=2.5, **named)
        for k, sensor in enumerate(sensor for sensor in case.sensors if isinstance(sensor, Probes)):
            axis.plot(
                *np.array(sensor.points).T, "o+x"[k % 3], color=CONTROLLED, ms=3 + 2 * k, mfc="none", label=sensor.name
            )
        axis.locator_params(nbins=5)
        axis.set(xlabel="x", ylabel="y", xlim=x, ylim=y, aspect="equal" if height > SLIM else "auto")
    if axes[-1].get_legend_handles_labels()[0]:
        axes[0].legend(ncols=4, loc="lower right", bbox_to_anchor=(1.0, 1.0), fontsize=9, borderpad=0.1)
    _save(figure, path)


def _draw_vorticity(axis: Axes, case: Case, drawn: Raster, state: Start):
    view, length = drawn.view, case.scales.length
    values = np.ma.array(drawn.vorticity(state) * case.convective_time, mask=~drawn.fluid)
    (left, right), (low, high) = np.array([view.x, view.y]) / length
    ends = float(left), float(right), float(low), float(high)
    picture = axis.imshow(values, "RdBu_r", vmin=-3, vmax=3, extent=ends, interpolation="bilinear", aspect="auto")
    for body in case.bodies:
        axis.add_patch(Polygon(outline(body) / length, color="#888888", lw=0))
    unit = "D" if any(isinstance(b, Circle) and np.isclose(2 * b.radius, length) for b in case.bodies) else "L"
    axis.set(xlabel=f"x/{unit}", ylabel=f"y/{unit}", xlim=ends[:2], ylim=ends[2:], box_aspect=view.height / view.width)
    return picture


def wake(
    flow: Flow, uncontrolled: Start, controlled: Start, record: dict[str, np.ndarray], title: str, path: Path
) -> None:
    """Draw the flow without and with control at one time, and the series that led there.

    uncontrolled, controlled: the states at the end of the record. record: columns of wake.csv.
    """
    case, base = flow.case, flow.baseline
    drawn = Raster(flow.operators.space, framed(case, base.mesh, PIXELS))
    field, names, time = 4.6 * drawn.view.height / PIXELS, base.shown, record["time"]
    heights = [field + 0.6, *[1.5] * len(names), 1.2]
    figure = _figure(11, sum(heights) + 1.2, f"{title}, {time[-1]:.4g} L/U after control began")
    grid = figure.add_gridspec(2, 1, height_ratios=[field + 0.9, sum(heights[1:])])
    above, below = (figure.add_subfigure(part) for part in (grid[0], grid[1]))
    fields = above.subplots(1, 2, sharey=True)
    pictures = ("uncontrolled", UNCONTROLLED, uncontrolled), ("controlled", CONTROLLED, controlled)
    for axis, (name, color, state) in zip(fields, pictures, strict=True):
        picture = _draw_vorticity(axis, case, drawn, state)
        axis.set_title(name, loc="left", color=color, fontsize=10)
    fields[1].set_ylabel("")
    beside = fields[1].inset_axes((1.02, 0, 0.02, 1))
    above.colorbar(picture, cax=beside, label="vorticity [U/L]", extend="both", extendfrac=0.08)
    axes = below.subplots(len(names) + 1, 1, sharex=True, height_ratios=heights[1:])
    for axis, name in zip(axes, names, strict=False):
        free, series = record[f"{name}_uncontrolled"], record[name]
        axis.plot(time, free, color=UNCONTROLLED, lw=0.8, label="uncontrolled")
        axis.plot(time, series, color=CONTROLLED, lw=1.2, label="controlled")
        axis.axhline(base.steady[name], **STEADY)
        axis.set_ylabel(LABELS.get(name, name))
        _limit(axis, series, [*free, base.steady[name]])
    driven = {actuator.on: record[f"amplitude.{actuator.on}"] / actuator.limit for actuator in case.actuators}
    for k, (name, series) in enumerate(driven.items()):
        axes[-1].plot(time, series, color=COLOURS[k % len(COLOURS)], lw=1.0, label=name)
    most = 1.1 * max((float(np.nanmax(abs(series))) for series in driven.values()), default=0.0) or 1.0
    axes[-1].set(xlabel="time [L/U]", ylabel="amplitude / limit", ylim=(-most, most), xlim=(0, time[-1]))
    for axis in axes:
        axis.grid(alpha=0.25)
    for axis in (axes[0], axes[-1]):
        axis.legend(ncols=5, loc="lower right", bbox_to_anchor=(1.0, 0.98), fontsize=9, borderpad=0.1)
    below.align_ylabels(axes)
    _save(figure, path)


def _limit(axis: Axes, series: np.ndarray, others: Sequence[float]) -> None:
    """Let an axis span other numbers, and a series once it has settled; say how far its start goes beyond.

    A start that would take no more than half of the axis again is shown whole.
    """
    finite = series[np.isfinite(series)]
    whole, late = (np.array([*part, *others]) for part in (finite, finite[int(SETTLED * len(series)) :]))
    cut = np.ptp(whole) > 1.5 * np.ptp(late)
    low, high = (late if cut else whole).min(), (late if cut else whole).max()
    room = 0.1 * (high - low) or 0.1
    axis.set_ylim(low - room, high + room)
    if cut:
        beyond = f"at first from {finite.min():.2f} to {finite.max():.2f}"
        axis.set_title(beyond, loc="left", fontsize=8, color=CONTROLLED, pad=2)


def compare(
    groups: Sequence[tuple[str, Sequence[tuple[np.ndarray, np.ndarray]]]],
    label: str,
    references: dict[str, float],
    path: Path,
) -> None:
    """Draw learning curves of groups of runs: one colour a group, a thin line a seed, the mean of the seeds thick.

    groups: names and the curves (episodes, values). references: values of the uncontrolled and of the steady flow.
    """
    figure = _figure(8, 4.6, "Learning curves of exploring policies: a thin line a seed, their mean thick")
    axis = figure.subplots()
    shades = [matplotlib.colormaps["viridis"](share) for share in np.linspace(0, 0.9, len(groups))]
    for color, (name, curves) in zip(GROUPS if len(groups) <= len(GROUPS) else shades, groups, strict=False):
        for x, y in curves:
            axis.plot(x, y, color=color, lw=0.7, alpha=0.6)
        if whole := [curve for curve in curves if len(curve[0])]:
            shortest = min(len(x) for x, _ in whole)
            x, y = (np.mean([part[:shortest] for part in parts], axis=0) for parts in zip(*whole, strict=True))
            axis.plot(x, y, color=color, lw=2.4, label=f"{name} ({len(curves)} seed{'s' * (len(curves) > 1)})")
    for style in (FREE, STEADY):
        if (value := references.get(style["label"])) is not None:
            axis.axhline(value, **{**style, "color": REFERENCE})
    axis.set(xlabel="episodes", ylabel=label)
    axis.grid(alpha=0.25)
    longest = max((len(name) for name, _ in groups), default=0)
    figure.legend(loc="outside lower center", ncols=int(np.clip(100 // (longest + 15), 1, 3)), fontsize=9)
    _save(figure, path)


def watch(table: dict[str, np.ndarray], newest: dict[str, np.ndarray], title: str, path: Path) -> None:
    """Draw a training under way: its learning curve on the left, the newest whole episode's series on the right.

    table: columns of episodes.csv, none before the first update. newest: at most two series, one number an action.
    """
    figure = _figure(8, 3.6, title)
    grid = figure.add_gridspec(1, 2)
    left, right = (figure.add_subfigure(part) for part in (grid[0], grid[1]))
    curve, name = left.subplots(), next(iter(newest))
    column, of = _of_episodes(table, name)
    if column in table:
        curve.plot(table["episode"] + 1, table[column], ".", color=CONTROLLED, alpha=0.3, markersize=5, mew=0)
        curve.plot(*update_means(table, column), color=CONTROLLED, lw=2)
    curve.set(xlabel="episodes", ylabel=of)
    axes = right.subplots(len(newest), 1, sharex=True, squeeze=False)[:, 0]
    for axis, (series, values) in zip(axes, newest.items(), strict=True):
        axis.plot(np.arange(len(values)) + 1, values, color=CONTROLLED, lw=1.2)
        axis.set_ylabel(LABELS.get(series, series))
    axes[-1].set_xlabel("action of the newest whole episode")
    for axis in (curve, *axes):
        axis.grid(alpha=0.25)
    _save(figure, path)
