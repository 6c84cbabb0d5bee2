"""Trainings by the set: by protocol, each made once and kept, side by side or timed alone."""

import shutil
from collections import deque
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from typing import Any

from experiments.experiment import Setup
from manywake import api
from manywake.case import describe
from manywake.flow import store
from manywake.learn import blocks, collect, flows, runs, tables, train
from manywake.learn.engine import Engine, Processes, Threads
from manywake.learn.flows import Flows
from manywake.learn.runs import Run
from manywake.learn.settings import Collection, Settings
from manywake.suite import load
from manywake.suite.cylinder_jets import RELEASED
from manywake.suite.load import Chosen

NAME = "cylinder-jets-goda"
"""The paper's scheme and time step."""
CASE = load.load(NAME).case


def seeds(setup: Setup, count: int = 3) -> range:
    """Return the seeds of a series of trainings: three, as in the paper, or more."""
    return range(2 if setup.miniature else count)


def period(setup: Setup) -> int:
    """Return the episodes of an update by the paper's protocol."""
    return 4 if setup.miniature else RELEASED.update_period


@dataclass(frozen=True)
class Training:
    """A training by the folder it is kept in, runs/FIGURE/NAME-sSEED, and the words that say what is trained on.

    case, protocol, changes: as in `manywake.choose`.
    """

    figure: str
    name: str
    case: str
    protocol: str
    changes: tuple[tuple[str, Any], ...]
    settings: Settings

    @property
    def chosen(self) -> Chosen:
        return load.choose(self.case, self.protocol, **dict(self.changes))

    def run(self, setup: Setup) -> Run:
        """Return its run; ValueError when its folder holds another training."""
        name = f"{self.name.replace(' ', '-')}-s{self.settings.seed}"
        run = Run(setup.runs / f"{self.figure}{setup.tail}" / name)
        if (run.folder / "settings.json").exists() and not self._made(run):
            raise ValueError(
                f"figure: {run.folder} was made with other settings; delete it, or begin anew with --fresh"
            )
        return run

    def _made(self, run: Run) -> bool:
        digest = describe.digest(flows.settings(self.chosen))
        return run.settings == self.settings and run.simulation["digest"] == digest

    def __str__(self) -> str:
        return f"{self.figure} {self.name}, seed {self.settings.seed}"


def by_protocol(
    setup: Setup,
    figure: str,
    name: str,
    seed: int,
    episodes: int,
    case: str = NAME,
    protocol: str | None = None,
    collection: Collection = Collection(),  # noqa: B008
    **changes: Any,
) -> Training:
    """Return one training by protocol (that of the set-up), with changes of its case, task and learner by name.

    The protocol's 25 minibatches of an update are kept: a fifth of the batch each, whatever an episode's length.
    """
    protocol = protocol or setup.protocol
    chosen = load.choose(case, protocol, **changes)
    learning = replace(chosen.learning, episodes=episodes)
    if setup.miniature:
        changes |= {"actions": 2, "interval": min(chosen.task.interval, 10 * chosen.case.dt)}
        small = {"update_period": 4, "episodes": 4 * min(episodes // 20, 3), "n_epochs": 1, "hidden": (8, 8)}
        learning = replace(learning, learner_threads=1, **small)
    if protocol != "default":
        actions = changes.get("actions", chosen.task.actions)
        learning = replace(learning, batch_size=max(learning.update_period * actions // 5, 2))
    settings = Settings(learning, collection, seed)
    return Training(figure, name, case, protocol, tuple(changes.items()), settings)


def seeded(
    setup: Setup, figure: str, episodes: int, sets: dict[str, dict[str, Any]], count: int = 3
) -> dict[str, list[Training]]:
    """Return series of trainings, one for each of `count` seeds; a series is what its settings change."""
    return {
        series: [by_protocol(setup, figure, series, seed, episodes, **changes) for seed in seeds(setup, count)]
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
            store.get(training.chosen.case, setup.progress)
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
                flying[engine.submit(_train_on, run, training, share)] = training, run
            done, _ = wait(flying, timeout=1.0, return_when=FIRST_COMPLETED)
            for training, run in flying.values():
                learning = training.settings.learning
                updates = len(tables.read(run.folder / "updates.csv"))
                setup.progress(str(training), min(updates * learning.update_period / learning.episodes, 1.0))
            for future in done:
                del flying[future]
                future.result()


def timed(setup: Setup, training: Training) -> Run:
    """Return a training's run made with nothing beside it and a process a worker, for the times in its tables."""
    run, done = training.run(setup), 0

    def show(episodes, shares, failures) -> None:
        nonlocal done
        done += len(episodes)
        setup.progress(str(training), min(done / training.settings.learning.episodes, 1.0))

    if not _done(run):
        simulation = flows.open_flows(training.chosen, setup.progress)
        # one that was stopped has the stop in its times
        shutil.rmtree(run.folder, ignore_errors=True)
        _end(run, api.train_into(run.folder, simulation, training.settings, show))
    return run


def _done(run: Run) -> bool:
    return (run.folder / "training.json").exists()


def _end(run: Run, result: train.Trained) -> None:
    """Write down that a training has come to its end."""
    runs.write_json(run.folder / "training.json", asdict(result))


def _train_on(run: Run, training: Training, cores: int) -> None:
    """Train in this process, with threads for more than one core; or go on from where a training was stopped."""
    if (run.folder / "settings.json").exists():
        _end(run, api.resume(api.load_run(run.folder), engine="threads"))
        return
    settings = training.settings
    how = settings.collection
    grid = blocks.layout(how.envs, how.workers, how.lanes, settings.learning.update_period, cores)
    with closing(Threads(grid.workers)) as engine:
        _end(run, train.train(run.folder, flows.open_flows(training.chosen), settings, engine, grid))


def opened(run: Run) -> Flows:
    """Return what a run played."""
    played = api.load_run(run.folder).simulation
    assert isinstance(played, Flows)
    return played
