"""Training with 1, 2, 5, 10 and 20 environments, synced (the paper's figure 4).

Claim: with a divider of T_L = 20 environments, synced, the learning curves are identical, so the speed-up is N.
Here: three seeds of 300 episodes with N = 20. An episode depends on its number, not on who plays it, so the other N
have the same curves to the bit: proved by training seed 0 anew with each N, all 300 episodes; a difference of one bit
is an error. Their times are derived (`schedule.synced`) from the duration of an episode that has one core and one lane
for itself, measured with N = 1; N = 1 and 2 are compared with the wall clock. The times are of TIMED_UPDATES updates
made with nothing beside them, in processes; the trainings of the curves run side by side, a core each.
Command: manywake figure synced
Cost: 5 min for the times, 21 for the trainings (N = 1, in one lane, is 14 of one core, N = 2 eight).
Expected: identical True everywhere; speed-up near N at the learner's 0.3 % that the paper had, and less with ours,
whose episodes are so short that the learner counts: Amdahl's law, `shares`.
"""

from dataclasses import fields
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

from experiments import learning_curves, trainings
from experiments.experiment import Setup, Table, names, read, rounded, where, write
from experiments.learning_curves import COLOURS
from experiments.trainings import Training
from manywake.learn import schedule, tables
from manywake.learn.runs import Run
from manywake.learn.settings import Collection
from manywake.machine import disk
from manywake.suite.cylinder_jets import RELEASED

BY_PROTOCOL = True
EPISODES = 300
TIMED_UPDATES = 3
"""Updates that are trained with nothing beside them, for their times."""
OTHERS = (1, 2, 5, 10)
PAPER_SHARE = 0.003
"""The learner's share of the paper's serial training."""


def group(setup: Setup, count: int = 3) -> dict[str, list[Training]]:
    """Return the trainings with as many environments as an update has episodes, one for each of `count` seeds."""
    return trainings.seeded(setup, "synced", EPISODES, {"20": {}}, count)


def wanted(setup: Setup) -> dict[str, list[Training]]:
    """Return the trainings: those, and seed 0 anew with each of the other N, which takes longest."""
    ways = {n: Collection(envs=n) for n in others(setup)}
    anew = [trainings.by_protocol(setup, "synced", str(n), 0, EPISODES, collection=how) for n, how in ways.items()]
    return {"anew": anew} | group(setup)


def timed(setup: Setup, environments: int) -> Run:
    """Return the first updates of seed 0, alone on the machine; 1 and 2 environments have a core and one lane each."""
    how = Collection() if environments == most(setup) else Collection(envs=environments, lanes=1)
    episodes = TIMED_UPDATES * RELEASED.update_period
    return trainings.timed(
        setup, trainings.by_protocol(setup, "synced", f"timed {environments}", 0, episodes, collection=how)
    )


def measure(setup: Setup) -> list[Run]:
    """Write synced-times.csv, and return the runs it is of."""
    alone = [timed(setup, n) for n in (1, 2, most(setup))]
    write(setup.csv("synced-times"), [_times(run) for run in alone])
    return alone


def others(setup: Setup) -> tuple[int, ...]:
    return OTHERS if not setup.miniature else (1, 2)


def run(setup: Setup) -> None:
    alone = measure(setup)
    sets = trainings.trained(setup, wanted(setup))
    learning_curves.write_tables(setup, "synced", {"N = 20": sets["20"]})
    proof = [_compared(sets["20"][0], run) for run in [*sets["anew"], *alone]]
    write(setup.csv("synced-proof"), proof)
    different = [row["environments"] for row in proof if not row["identical"]]
    if different:
        raise RuntimeError(
            f"synced: seed 0 with {different} environments differs from 20; see {setup.csv('synced-proof')}"
        )


def _compared(whole: Run, part: Run) -> dict[str, Any]:
    """Compare all numbers of the episodes but the times, and the policy after the last update, to the bit."""
    updates = part.settings.learning.episodes // part.settings.learning.update_period
    a, b = (_untimed(run, updates) for run in (whole, part))
    digests = [policy_digest(run, updates) for run in (whole, part)]
    return {
        "environments": part.layout.environments,
        "workers": part.layout.workers,
        "lanes": part.layout.lanes,
        "episodes": len(b),
        "numbers": sum(len(row) for row in b),
        "different": sum(x != y for x, y in zip(a, b, strict=True)),
        "policy": digests[1],
        "policy_of_20": digests[0],
        "identical": a == b and digests[0] == digests[1],
    }


def _untimed(run: Run, updates: int) -> list[tuple[str, ...]]:
    return tables.untimed([row for row in tables.read(run.folder / "episodes.csv") if int(row["update"]) < updates])


def policy_digest(run: Run, version: int) -> str:
    """Return the hash of a policy's weights, normaliser and noise."""
    policy = run.version(version)
    arrays = {f.name: getattr(policy, f.name) for f in fields(policy) if f.name not in ("version", "layers")}
    arrays |= {f"{k}{part}": array for k, layer in enumerate(policy.layers) for part, array in enumerate(layer)}
    return disk.digest(arrays)


def _times(run: Run) -> dict[str, Any]:
    """Return what episodes and updates took, and what the schedule makes of the very durations that were measured.

    Of the updates after the first, which also loads compiled code. episode_s, spread: of one environment; with lanes,
    its share of a block. schedule_s: only without lanes, where an environment's episodes are its own.
    """
    layout, period = run.layout, run.settings.learning.update_period
    first, *updates = tables.read(run.folder / "updates.csv")
    rows = tables.read(run.folder / "episodes.csv")[period : (len(updates) + 1) * period]
    seconds = np.array([float(row["flow_s"]) + float(row["policy_s"]) for row in rows])
    learner = np.mean([float(row["learner_s"]) for row in updates])
    plan = schedule.synced(seconds, layout.environments, period, float(learner))
    return rounded(
        {
            "environments": layout.environments,
            "workers": layout.workers,
            "lanes": layout.lanes,
            "episode_s": seconds.mean(),
            "spread": seconds.std() / seconds.mean(),
            "update_s": learner,
            "updates": len(updates),
            "collect_s": sum(float(row["collect_s"]) for row in updates),
            "wall_s": float(updates[-1]["wall_s"]) - float(first["wall_s"]),
            "schedule_s": plan.ready[-1] if layout.lanes == 1 else np.nan,
        }
    )


def times(setup: Setup) -> dict[str, float]:
    """Return the measured times of one environment in one lane on one core."""
    table = where(read(setup.csv("synced-times")), environments=1)
    return {name: float(column[0]) for name, column in table.items()}


def derived(setup: Setup, environments: int, seed: int, episodes: int, learner: float | None = None) -> schedule.Plan:
    """Return when episodes would come with a core for each environment; learner: share of a serial training's time."""
    one, period = times(setup), trainings.period(setup)
    update = one["update_s"] if learner is None else learner / (1 - learner) * period * one["episode_s"]
    seconds = schedule.durations(seed, episodes, one["episode_s"], one["spread"])
    return schedule.synced(seconds, environments, period, update)


def speedup(setup: Setup, learner: float | None = None) -> dict[int, float]:
    """Return the serial training's time over that of each N."""
    ends = {n: derived(setup, n, 0, EPISODES, learner).ready[-1] for n in (*others(setup), most(setup))}
    return {n: float(ends[1] / end) for n, end in ends.items()}


def most(setup: Setup) -> int:
    """Return the most environments that are synced."""
    return 4 if setup.miniature else 20


def plot(setup: Setup) -> None:
    table, proof = read(setup.csv("synced")), read(setup.csv("synced-proof"))
    figure = plt.figure(figsize=(14, 7))
    grid = figure.add_gridspec(2, 3)
    for row, (y, label) in enumerate((("c_d", "$C_D$, 2nd half of episode"), ("reward", "reward of an action"))):
        axis = figure.add_subplot(grid[row, 0])
        learning_curves.draw(axis, table, "arrived", y, COLOURS[0], "N = 20, 3 seeds")
        if y == "c_d":
            learning_curves.references(axis)
            axis.set_ylim(top=axis.get_ylim()[1] + 0.15)  # room for the legend
            axis.legend(fontsize=8, title=_proved(proof), title_fontsize=8, loc="upper right")
        learning_curves.finish(axis, "episodes", label)
        axis = figure.add_subplot(grid[row, 1])
        for colour, n in zip(COLOURS, (*others(setup), most(setup)), strict=False):
            learning_curves.draw(axis, _against_time(setup, table, n), "minutes", y, colour, f"N = {n}")
        learning_curves.finish(axis, "time [min], derived: a core and one lane for each of N", label)
        axis.set_xscale("log")
        if y == "c_d":
            learning_curves.references(axis, label=False)
            axis.legend(fontsize=9)
    _plot_speedup(setup, figure.add_subplot(grid[:, 2]))
    learning_curves.save(figure, setup.png("synced"), "Synced training with N environments: runs thin, mean thick")


def _proved(proof: Table) -> str:
    same = all(proof["identical"] == "True")
    compared = _compared_episodes(proof)
    which = ", ".join(n for n, episodes in compared.items() if episodes == max(compared.values()))
    return (
        f"N = {which}: the same to the bit\n(seed 0, {max(compared.values())} episodes anew)"
        if same
        else "NOT the same"
    )


def _compared_episodes(proof: Table) -> dict[str, int]:
    """Return the length of the longest training that was made anew, by N; there are short ones, timed, beside them."""
    longest: dict[str, int] = {}
    for n, episodes in zip(proof["environments"], proof["episodes"], strict=True):
        longest[f"{n:g}"] = max(longest.get(f"{n:g}", 0), int(episodes))
    return longest


def _against_time(setup: Setup, table: Table, environments: int) -> Table:
    """Return the curves of N = 20 at the times that N environments would have had them."""
    minutes = [
        derived(setup, environments, int(seed), len(where(table, seed=seed)["seed"])).time / 60
        for seed in names(table, "seed")
    ]
    return {**table, "minutes": np.concatenate(minutes)}


def _plot_speedup(setup: Setup, axis) -> None:
    ours, theirs = speedup(setup), speedup(setup, PAPER_SHARE)
    n = list(ours)
    axis.plot(n, n, color="#555555", lw=1, ls="--", label="ideal")
    axis.plot(n, list(theirs.values()), "o-", color=COLOURS[0], label="derived, learner 0.3 % (the paper's)")
    axis.plot(n, list(ours.values()), "s-", color=COLOURS[1], label="derived, our learner as measured")
    wall = measured(setup)
    axis.plot([1, 2], [1, wall["wall_speedup_of_2"]], "k*", ms=11, label="wall clock, 1 and 2 processes")
    axis.legend(fontsize=9, loc="upper left")
    learning_curves.finish(axis, "environments N", "speed-up")


def measured(setup: Setup) -> dict[str, float]:
    """Return how the schedule compares with the wall clock, and what lanes bring beside it."""
    table = read(setup.csv("synced-times"))
    one, two = (where(table, environments=n) for n in (1, 2))
    many = where(table, environments=most(setup))
    return {
        "wall_speedup_of_2": float(one["wall_s"][0] / two["wall_s"][0]),
        "derived_speedup_of_2": speedup(setup)[2],
        "wall_over_schedule_1": float(one["wall_s"][0] / one["schedule_s"][0]),
        "wall_over_schedule_2": float(two["wall_s"][0] / two["schedule_s"][0]),
        "episode_s": float(one["episode_s"][0]),
        "episode_s_beside_another": float(two["episode_s"][0]),
        "episode_spread": float(one["spread"][0]),
        "update_s": float(one["update_s"][0]),
        "collecting_with_lanes_over_one_environment": float(one["collect_s"][0] / many["collect_s"][0]),
    }


def summary(setup: Setup) -> dict:
    proof = read(setup.csv("synced-proof"))
    return {
        **learning_curves.summary(setup, "synced"),
        "identical": bool(all(proof["identical"] == "True")),
        "episodes_compared": _compared_episodes(proof),
        "speedup_derived_paper_learner": speedup(setup, PAPER_SHARE),
        "speedup_derived_our_learner": speedup(setup),
        "measured": measured(setup),
    }
