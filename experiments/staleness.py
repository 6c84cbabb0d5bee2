"""What it costs that an unsynced episode keeps the policy it began with: ours, beside the paper's figure 5.

Claim: none of the paper's. Its runner draws every action by the newest policy, and its learner takes PPO's ratio to the
policy about to be updated; then 60 environments learn nearly as well as 20 that are synced (`overparallel`).
Here: 60 environments whose episodes keep the policy they began with, and the ratio to that policy, as published PPO has
it: what `--schedule unsynced` does by default, and all it can do on the real clock. Eight seeds, 300 episodes, on the
virtual clock, beside the runs of `synced` and `overparallel`. Harm is judged as there.
Command: manywake figure staleness
Cost: 8 trainings beside those of the other two, 10 min of two cores. Not one of `manywake figure all`.
Expected: episodes 3, 4 and 5 updates old when they are used, not 0, 1 and 2; slower learning.
"""

from dataclasses import replace

from experiments import learning_curves, overparallel, trainings
from experiments.experiment import Setup, names, read, where
from experiments.trainings import Training

KEPT = "policy kept"
BY_PROTOCOL = True


def wanted(setup: Setup) -> dict[str, list[Training]]:
    """Return the trainings, those of `overparallel` with most environments among them."""
    most = max(overparallel.environments(setup))
    others = overparallel.wanted(setup)
    series = f"unsynced {most}, {KEPT}"
    changes = {series: {"collection": replace(overparallel.MODEL, envs=most)}}
    shared = {name: others[name] for name in ("synced 20", f"unsynced {most}")}
    return shared | trainings.seeded(setup, "staleness", overparallel.EPISODES, changes, overparallel.SEEDS)


def run(setup: Setup) -> None:
    learning_curves.write_tables(setup, "staleness", trainings.trained(setup, wanted(setup)))


def plot(setup: Setup) -> None:
    labels = {name: name for name in names(read(setup.csv("staleness")))}
    title = "Unsynced episodes that take the newest policy for every action, or keep one: runs thin, means thick"
    learning_curves.plot_against_episodes(setup, "staleness", labels, title)


def summary(setup: Setup) -> dict:
    final, updates = read(setup.csv("staleness-final")), read(setup.csv("staleness-updates"))
    found = learning_curves.summary(setup, "staleness")
    for series, row in found.items():
        mine = where(updates, series=series)
        row |= {name: float(mine[name].mean()) for name in ("staleness_mean", "clipped_before")}
    policies = {series: where(final, series=series)["c_d"].tolist() for series in names(final)}
    harm = {
        "harm_exploring": overparallel.harm(learning_curves.levels(read(setup.csv("staleness")))),
        "harm_policy": overparallel.harm(policies),
        "failed": overparallel.failed(final),
    }
    return found | harm
