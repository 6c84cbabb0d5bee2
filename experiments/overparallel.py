"""More environments than an update has episodes: 32 and 60, unsynced, beside synced 20 (the paper's figure 5).

Claim: learning is nearly as good at equal episodes, with clear steps, since several updates follow each other when the
environments end their episodes at about the same time; the speed-up is 55 to 60 at 60; that the second and third
update of such a burst are of older policies' episodes does no harm.
Here: eight seeds each, 300 episodes, on the virtual clock, which orders arrivals reproducibly: durations with a spread
of 0.5 %, an update of 0.3 % of the T_L episodes it is made of (the paper's share). As in the paper's code every action
is of the newest policy (`newest_policy`), and PPO's ratio is to the policy about to be updated (`ratio_to`). Times are
in episodes of one environment, drawn in seconds of an episode measured in one lane (`synced`): the speed-up is that of
the model, not of 60 environments on 60 cores. Harm: the difference of the mean final C_D from that of synced 20, with
its 95 % interval and the p of Welch's test, two-sided. A policy that is no better than no control is named by its seed.
Command: manywake figure overparallel
Cost: 24 trainings, of which 3 are those of `synced`: half an hour of two cores.
Expected: plateaus of 60 episodes; speed-up of 300 episodes 58 (they are 5 rounds of 60). When used, the last actions of
60 environments' episodes are 0, 1 and 2 updates old, as in the paper. The share of samples outside the clip range of
the policies that drew them shows how far off-policy an update is. (Synced 20 has its ratio to the policy that drew the
action; that differs from the current one by the update of the observations' normaliser alone.)
"""

from dataclasses import replace
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import scipy.stats

from experiments import learning_curves, synced, trainings
from experiments.experiment import Setup, Table, names, read, where, write
from experiments.learning_curves import COLOURS
from experiments.trainings import Training
from manywake.flow import store
from manywake.learn import schedule
from manywake.learn.settings import Collection

BY_PROTOCOL = True
EPISODES = 300
SEEDS = 8
MODEL = Collection(schedule="unsynced", clock="virtual")
"""The virtual clock: 0.3 s an update, 5 s an episode, spread 0.5 %."""


def environments(setup: Setup) -> tuple[int, ...]:
    return (6, 12) if setup.miniature else (32, 60)


def wanted(setup: Setup) -> dict[str, list[Training]]:
    """Return the trainings, those of `synced` among them."""
    ways = {n: replace(MODEL, envs=n, newest_policy="action") for n in environments(setup)}
    unsynced = {f"unsynced {n}": {"collection": how, "ratio_to": "current"} for n, how in ways.items()}
    synced_20 = {f"synced {name}": group for name, group in synced.group(setup, SEEDS).items()}
    return synced_20 | trainings.seeded(setup, "overparallel", EPISODES, unsynced, SEEDS)


def run(setup: Setup) -> None:
    sets = trainings.trained(setup, wanted(setup))
    learning_curves.write_tables(setup, "overparallel", sets)
    table = read(setup.csv("overparallel"))
    write(setup.csv("overparallel"), _on_the_virtual_clock(setup, table))
    if not setup.csv("synced-times").exists():
        synced.measure(setup)


def _on_the_virtual_clock(setup: Setup, table: Table) -> list[dict[str, Any]]:
    """Return the rows with their times in episodes of one environment; synced ones get the model's."""
    rows = [dict(zip(table, row, strict=True)) for row in zip(*table.values(), strict=True)]
    times = {int(seed): _plan(setup, int(seed), 20, False, EPISODES).time for seed in names(table, "seed")}
    for row in rows:
        for name in ("seed", "arrived", "update"):
            row[name] = int(row[name])
        if row["series"] == "synced 20":
            row["clock_s"] = times[row["seed"]][row["arrived"] - 1]
        row["clock"] = round(float(row.pop("clock_s")) / MODEL.episode_seconds, 4)
    return rows


def _plan(setup: Setup, seed: int, n: int, unsynced: bool, episodes: int, update: float = MODEL.update_seconds):
    """Return the schedule on the virtual clock, in its seconds."""
    period = trainings.period(setup)
    seconds = schedule.durations(seed, episodes, MODEL.episode_seconds, MODEL.episode_spread)
    return (schedule.unsynced if unsynced else schedule.synced)(
        seconds, min(n, period) if not unsynced else n, period, update
    )


def speedup(setup: Setup, n: int, unsynced: bool, update: float = MODEL.update_seconds) -> float:
    """Return the serial training's time over that of n environments."""
    ends = [_plan(setup, 0, k, how, EPISODES, update).ready[-1] for k, how in ((1, False), (n, unsynced))]
    return float(ends[0] / ends[1])


def plot(setup: Setup) -> None:
    table, updates = read(setup.csv("overparallel")), read(setup.csv("overparallel-updates"))
    seconds = synced.times(setup)["episode_s"]
    table["minutes"] = table["clock"] * seconds / 60
    figure, axes = plt.subplots(2, 3, figsize=(14, 7))
    for colour, series in zip(COLOURS, names(table), strict=False):
        mine = where(table, series=series)
        for row, y in enumerate(("c_d", "reward")):
            for column, x in enumerate(("arrived", "minutes")):
                learning_curves.draw(axes[row, column], mine, x, y, colour, series)
        _draw_updates(axes[1, 2], where(updates, series=series, seed=0), colour, series)
    for axis in axes[0, :2]:
        learning_curves.references(axis)
    time = f"time [min], virtual clock: episode {seconds:.2f} s, learner 0.3 %"
    for row, label in enumerate(("$C_D$, 2nd half of episode", "reward of an action")):
        learning_curves.finish(axes[row, 0], "episodes", label)
        learning_curves.finish(axes[row, 1], time, label)
    axes[0, 0].set_ylim(top=axes[0, 0].get_ylim()[1] + 0.16)  # room for the legend
    axes[0, 0].legend(fontsize=8, ncols=2, loc="upper right")
    _plot_speedup(setup, axes[0, 2])
    axes[1, 2].legend(fontsize=8, loc="upper right")
    axes[1, 2].set_ylim(top=1.6 * axes[1, 2].get_ylim()[1])
    learning_curves.finish(axes[1, 2], "update (seed 0)", "age of its episodes (line)\nupdates in a row (dots)")
    title = "More environments than an update has episodes: runs thin, means thick"
    learning_curves.save(figure, setup.png("overparallel"), title)


def _draw_updates(axis, updates: Table, colour: str, label: str) -> None:
    axis.plot(updates["update"], updates["staleness_mean"], color=colour, drawstyle="steps-mid", label=label)
    axis.plot(updates["update"], updates["burst"], "o", color=colour, ms=4)


def _plot_speedup(setup: Setup, axis) -> None:
    counts = sorted([(1, False), (20, False), *((n, True) for n in environments(setup))])
    n = [count for count, _ in counts]
    axis.plot(n, n, color="#555555", lw=1, ls="--", label="ideal")
    models = (("0.3 % (the paper's)", MODEL.update_seconds), ("as measured here", _ours(setup)))
    for colour, (learner, update) in zip(COLOURS, models, strict=False):
        speedups = [speedup(setup, *count, update) for count in counts]
        axis.plot(n, speedups, "o-", color=colour, label=f"derived, learner {learner}")
    axis.legend(fontsize=9, loc="upper left")
    learning_curves.finish(axis, "environments", f"speed-up, {EPISODES} episodes")


def _ours(setup: Setup) -> float:
    """Return our learner's update in the virtual clock's seconds."""
    one = synced.times(setup)
    return one["update_s"] / one["episode_s"] * MODEL.episode_seconds


def harm(drag: dict[str, list[float]], reference: str = "synced 20") -> dict[str, dict[str, Any]]:
    """Compare the final drag of the seeds with that of the reference; positive differences are harm.

    low, high: of the difference's 95 % interval. p: of Welch's test, two-sided.
    """
    found = {}
    for series in (name for name in drag if name != reference):
        test = scipy.stats.ttest_ind(drag[series], drag[reference], equal_var=False)
        interval = test.confidence_interval(0.95)
        found[series] = {
            "seeds": len(drag[series]),
            "difference": float(np.mean(drag[series]) - np.mean(drag[reference])),
            "low": float(interval.low),
            "high": float(interval.high),
            "p": float(test.pvalue),
        }
    return found


def failed(final: Table) -> dict[str, list[int]]:
    """Return the seeds whose policy has no less drag than no control, by series that have any."""
    base = store.get(trainings.CASE).free["c_d"]
    found = {series: where(final, series=series) for series in names(final)}
    seeds = {name: part["seed"][part["c_d"] >= base].astype(int).tolist() for name, part in found.items()}
    return {series: those for series, those in seeds.items() if those}


def summary(setup: Setup) -> dict:
    table, updates = read(setup.csv("overparallel")), read(setup.csv("overparallel-updates"))
    final = read(setup.csv("overparallel-final"))
    rows = learning_curves.summary(setup, "overparallel")
    for series, row in rows.items():
        mine = where(updates, series=series)
        for name in ("staleness_mean", "staleness_max", "clipped_before", "clip_fraction", "burst"):
            row[name] = float(np.nanmax(mine[name]) if name.endswith("max") else np.nanmean(mine[name]))
        n = int(series.split()[1])
        row["speedup_paper_learner"] = speedup(setup, n, series.startswith("unsynced"))
        row["speedup_our_learner"] = speedup(setup, n, series.startswith("unsynced"), _ours(setup))
    policies = {series: where(final, series=series)["c_d"].tolist() for series in names(final)}
    return rows | {
        "harm_exploring": harm(learning_curves.levels(table)),
        "harm_policy": harm(policies),
        "failed": failed(final),
    }
