"""Learning curves of trainings as tables, and drawn with runs thin and means thick."""

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from experiments import policies_in_lanes, trainings
from experiments.experiment import Setup, Table, names, read, rounded, spread, where, write
from manywake import plots
from manywake.flow import store
from manywake.learn import tables
from manywake.learn.runs import Run

WINDOW = 10
"""Episodes of the running mean that is drawn."""
LAST = 60
"""Episodes, the last ones, whose mean is a run's final level."""
COLOURS = ("#2f6c9f", "#c44e52", "#55a868", "#dd8452", "#8172b3")


def write_tables(setup: Setup, name: str, sets: dict[str, list[Run]]) -> None:
    """Write NAME.csv (a row per episode), NAME-updates.csv, and NAME-final.csv (each last policy, deterministic).

    All runs are cut to the length of the shortest.
    """
    pairs = [(series, run) for series, group in sets.items() for run in group]
    each = [run.settings.learning for _, run in pairs]
    updates = min(learning.episodes // learning.update_period for learning in each)
    write(setup.csv(name), [row for series, run in pairs for row in _episodes(series, run, updates)])
    write(setup.csv(f"{name}-updates"), [row for series, run in pairs for row in _updates(series, run, updates)])
    write(setup.csv(f"{name}-final"), [row for series, group in sets.items() for row in _final(series, group, updates)])


def _episodes(series: str, run: Run, updates: int) -> list[dict[str, Any]]:
    """Return rows in the order episodes came. reward: mean of an action. clock_s: the run's own clock."""
    unsynced = run.settings.collection.schedule == "unsynced"
    table = [row for row in tables.read(run.folder / "episodes.csv") if int(row["update"]) < updates]
    table.sort(key=lambda row: (float(row["clock_s"]) if unsynced else 0.0, int(row["episode"])))
    return [
        rounded(
            {
                "series": series,
                "seed": run.settings.seed,
                "arrived": k + 1,
                "update": int(row["update"]),
                "staleness": float(row["staleness"]),
                "c_d": float(row["c_d_second_half"]),
                "c_l": float(row["c_l_second_half"]),
                "reward": float(row["reward"]) / int(row["length"]),
                "jet_rms": float(row["amplitude_rms"]),
                "clock_s": float(row["clock_s"]),
            }
        )
        for k, row in enumerate(table)
    ]


def _updates(series: str, run: Run, updates: int) -> list[dict[str, Any]]:
    table = tables.read(run.folder / "updates.csv")[:updates]
    columns = [name for name in table[0] if name not in ("update", "episodes", "learning_rate")]
    return [
        {"series": series, "seed": run.settings.seed, "update": int(row["update"])}
        | rounded({name: float(row[name]) for name in columns})
        for row in table
    ]


def _final(series: str, group: list[Run], updates: int) -> list[dict[str, Any]]:
    played = trainings.opened(group[0])
    flow, driving = played.flows[0], [run.version(updates) for run in group]
    result = policies_in_lanes.play(flow, played.task, driving, played.horizon)
    half, limit = len(result["c_d"]) // 2, flow.case.actuators[0].limit
    return [
        rounded(
            {
                "series": series,
                "seed": run.settings.seed,
                "c_d": result["c_d"][half:, k].mean(),
                "c_l": result["c_l"][half:, k].mean(),
                "jet_rms": np.sqrt(np.mean(result["jet"][half:, k] ** 2)) / limit,
            },
            5,
        )
        for k, run in enumerate(group)
    ]


def running_mean(values: np.ndarray, window: int = WINDOW) -> np.ndarray:
    """Return the mean over the last `window` values, fewer at the start, without those that are not finite."""
    there = np.isfinite(values)
    total, count = np.cumsum(np.where(there, values, 0.0)), np.cumsum(there.astype(float))
    for sums in (total, count):
        sums[window:] = sums[window:] - sums[:-window]
    return np.divide(total, count, out=np.full(len(values), np.nan), where=count > 0)


def draw(axis, table: Table, x: str, y: str, colour: str, label: str) -> None:
    """Draw the runs of one series: each thin, their mean thick (of x too, where that is a time)."""
    each = [where(table, seed=seed) for seed in names(table, "seed")]
    each = [{key: column[np.argsort(run[x], kind="stable")] for key, column in run.items()} for run in each]
    lines = [(run[x], running_mean(run[y])) for run in each]
    for at, values in lines:
        axis.plot(at, values, color=colour, lw=0.6, alpha=0.55)
    axis.plot(*np.mean(lines, axis=0), color=colour, lw=2.2, label=label)


def references(axis, label: bool = True) -> None:
    """Draw the uncontrolled flow's C_D and that of the steady base flow."""
    base = store.get(trainings.CASE)
    for value, style, name in ((base.free["c_d"], ":", "uncontrolled"), (base.steady["c_d"], "--", "steady flow")):
        axis.axhline(value, color=plots.REFERENCE, lw=1, ls=style, label=name if label else None)


def plot_against_episodes(setup: Setup, name: str, labels: dict[str, str], title: str) -> None:
    """Draw C_D and the reward of all series against episodes."""
    table = read(setup.csv(name))
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.2))
    for colour, (series, label) in zip(COLOURS, labels.items(), strict=False):
        draw(axes[0], where(table, series=series), "arrived", "c_d", colour, label)
        draw(axes[1], where(table, series=series), "arrived", "reward", colour, label)
    references(axes[0])
    finish(axes[0], "episodes", f"$C_D$, 2nd half of episode, mean of {WINDOW}")
    finish(axes[1], "episodes", "reward of an action")
    figure.legend(*axes[0].get_legend_handles_labels(), ncols=len(labels) + 2, loc="lower center", fontsize=9)
    save(figure, setup.png(name), title, below=0.07)


def finish(axis, x: str, y: str) -> None:
    """Label an axis."""
    axis.set_xlabel(x)
    axis.set_ylabel(y)
    axis.grid(alpha=0.25)


def save(figure, path: Path, title: str, below: float = 0.0) -> None:
    """Write a figure, with its title at the left and room below for a legend."""
    figure.suptitle(title, x=0.01, ha="left", fontsize=11)
    if figure.get_layout_engine() is None:
        figure.tight_layout(rect=(0, below, 1, 1))
    figure.savefig(path)
    plt.close(figure)


def levels(table: Table, column: str = "c_d") -> dict[str, list[float]]:
    """Return the mean over the last episodes of each run, by series."""
    return {
        series: [
            float(np.nanmean(where(table, series=series, seed=seed)[column][-LAST:]))
            for seed in names(where(table, series=series), "seed")
        ]
        for series in names(table)
    }


def summary(setup: Setup, name: str) -> dict[str, Any]:
    """Return, by series, first and final level while exploring, and the last policies' own, as mean and deviation."""
    table, final = read(setup.csv(name)), read(setup.csv(f"{name}-final"))
    uncontrolled = store.get(trainings.CASE).free["c_d"]
    found: dict[str, Any] = {}
    for series in names(table):
        mine, last = where(table, series=series), where(final, series=series)
        untrained = mine["staleness"] == mine["update"]  # all of it by version 0
        first = {key: column[untrained] for key, column in mine.items()}
        drag = levels(mine)[series]
        found[series] = {
            "exploring_c_d_first": float(np.nanmean(first["c_d"])),
            "exploring_c_d": spread(drag),
            "exploring_reduction": spread(1 - value / uncontrolled for value in drag),
            "reward_first": float(np.nanmean(first["reward"])),
            "reward": spread(levels(mine, "reward")[series]),
            "policy_c_d": spread(last["c_d"]),
            "policy_reduction": spread(1 - last["c_d"] / uncontrolled),
            "policy_c_l": last["c_l"].tolist(),
        }
    return found
