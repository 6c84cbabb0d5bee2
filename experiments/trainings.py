"""Trainings by the set: by protocol, each made once and kept, side by side or timed alone."""

import shutil
from collections import deque
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

from experiment import Setup

from manywake.flow import baseline, case
from manywake.flow.case import Case
from manywake.learn import collect, runs, train
from manywake.learn.engine import Engine, Processes, Threads
from manywake.learn.rollout import JetFlows
from manywake.learn.runs import Run
from manywake.learn.settings import PROTOCOLS, Collection, Settings

CASE = case.by_name("cylinder-jets-goda")
"""The paper's scheme and time step."""


def seeds(setup: Setup) -> range:
    """Return the seeds of a series of trainings: three, as in the paper."""
    return range(2 if setup.miniature else 3)


def settings(
    setup: Setup,
    seed: int,
    episodes: int,
    protocol: str | None = None,
    chosen: Case = CASE,
    collection: Collection = Collection(),  # noqa: B008
    ratio_to: Literal["behaviour", "current"] = "behaviour",
    **changes: Any,
) -> Settings:
    """Return the settings of one training by protocol (that of the set-up), with changes of its task.

    The protocol's 25 minibatches of an update are kept: a fifth of the batch each, whatever an episode's length.
    """
    protocol = protocol or setup.protocol
    task, learning = PROTOCOLS[protocol]
    task, learning = replace(task, **changes), replace(learning, episodes=episodes, ratio_to=ratio_to)
    if setup.miniature:
        brief = min(task.action_interval, 10 * chosen.time_step)
        task = replace(task, actions_per_episode=2, action_interval=brief)
        small = {"update_period": 4, "episodes": 4 * min(episodes // 20, 3), "n_epochs": 1, "hidden": (8, 8)}
        learning = replace(learning, learner_threads=1, **small)
    if protocol != "default":
        batch = max(learning.update_period * task.actions_per_episode // 5, 2)
        learning = replace(learning, batch_size=batch)
    return Settings(chosen, task, learning, collection, seed)


@dataclass(frozen=True)
class Training:
    """A training by the folder it is kept in: runs/FIGURE/NAME-sSEED."""

    figure: str
    name: str
    settings: Settings

    def run(self, setup: Setup) -> Run:
        """Return its run; ValueError when its folder holds another training."""
        name = f"{self.name.replace(' ', '-')}-s{self.settings.seed}"
        run = Run(setup.runs / f"{self.figure}{setup.tail}" / name)
        if (run.folder / "settings.json").exists() and run.settings != self.settings:
            raise ValueError(
                f"figure: {run.folder} was made with other settings; delete it, or begin anew with --fresh"
            )
        return run

    def __str__(self) -> str:
        return f"{self.figure} {self.name}, seed {self.settings.seed}"


def seeded(setup: Setup, figure: str, episodes: int, sets: dict[str, dict[str, Any]]) -> dict[str, list[Training]]:
    """Return series of trainings, one for each seed; a series is what its settings change."""
    return {
        series: [Training(figure, series, settings(setup, seed, episodes, **changes)) for seed in seeds(setup)]
        for series, changes in sets.items()
    }


def trained(setup: Setup, sets: dict[str, list[Training]]) -> dict[str, list[Run]]:
    """Return the runs of series of trainings: kept, brought to their end, or new."""
    train_all(setup, [training for group in sets.values() for training in group])
    return {series: [training.run(setup) for training in group] for series, group in sets.items()}


def train_all(setup: Setup, wanted: Sequence[Training]) -> None:
    """Train what is not trained yet, side by side, a core each.

    Two trainings of one core take a little less time than one after the other on two, as the learner has one thread. No
    core is idle before the last of them begins; so name the longest first.
    """
    waiting: deque[tuple[Training, Run]] = deque()
    for training in dict.fromkeys(wanted):
        run = training.run(setup)
        if not _done(run):
            baseline.get(training.settings.case, setup.progress)
            waiting.append((training, run))
    if not waiting:
        return
    cores = collect.usable_cores()
    engine: Engine = Threads(1) if setup.miniature else Processes(min(cores, len(waiting)))
    flying: dict[Future, tuple[Training, Run]] = {}
    with closing(engine):
        share = cores // engine.slots
        while waiting or flying:
            while waiting and len(flying) < engine.slots:
                training, run = waiting.popleft()
                flying[engine.submit(_train_on, run, training.settings, share)] = training, run
            done, _ = wait(flying, timeout=1.0, return_when=FIRST_COMPLETED)
            for training, run in flying.values():
                learning = training.settings.learning
                updates = len(runs.rows(run.folder / "updates.csv"))
                setup.progress(str(training), min(updates * learning.update_period / learning.episodes, 1.0))
            for future in done:
                del flying[future]
                future.result()


def timed(setup: Setup, training: Training) -> Run:
    """Return a training's run made with nothing beside it and a process a worker, for the times in its tables."""
    run, chosen = training.run(setup), training.settings
    if not _done(run):
        baseline.get(chosen.case, setup.progress)
        how, done = chosen.collection, 0
        layout = collect.layout(how.envs, how.workers, how.lanes, chosen.learning.update_period)

        def show(episodes, shares, failures) -> None:
            nonlocal done
            done += len(episodes)
            setup.progress(str(training), min(done / chosen.learning.episodes, 1.0))

        # one that was stopped has the stop in its times
        shutil.rmtree(run.folder, ignore_errors=True)
        with closing(Processes(layout.workers)) as engine:
            _train(run, chosen, engine, layout, show)
    return run


def _done(run: Run) -> bool:
    return (run.folder / "training.json").exists()


def _train_on(run: Run, chosen: Settings, cores: int) -> None:
    """Train in this process, with threads for more than one core."""
    how = chosen.collection
    layout = collect.layout(how.envs, how.workers, how.lanes, chosen.learning.update_period, cores)
    with closing(Threads(layout.workers)) as engine:
        _train(run, chosen, engine, layout)


def _train(
    run: Run, chosen: Settings, engine: Engine, layout: collect.Layout, show: train.Show = lambda *_: None
) -> None:
    """Train, or go on from where a training was stopped, and write down that it has come to its end."""
    if (run.folder / "settings.json").exists():
        result = train.resume(run.folder, engine, layout, show)
    else:
        result = train.train(run.folder, chosen, engine, layout, show)
    runs.write_json(run.folder / "training.json", asdict(result))


def simulation(run: Run) -> JetFlows:
    """Return what a run played."""
    played = run.simulation()
    assert isinstance(played, JetFlows)
    return played
