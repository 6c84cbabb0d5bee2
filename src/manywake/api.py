"""Training, evaluating and reopening runs from Python; the command line is made of these.

    run = manywake.train(reynolds=120, seed=1)
    print(manywake.evaluate(run).summary()["drag_reduction"])

torch is loaded by the first call that needs it.
"""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from manywake.case.case import Case
from manywake.case.learning import Learning
from manywake.case.task import Task
from manywake.flow.baseline import Progress
from manywake.learn import blocks, controllers, external, flows
from manywake.learn import policy as policies
from manywake.learn.collect import usable_cores
from manywake.learn.engine import Engine, Processes, Threads
from manywake.learn.evaluate import Evaluation, Evaluations
from manywake.learn.policy import Policy
from manywake.learn.rollout import Evaluated, Simulation
from manywake.learn.runs import Run, checked
from manywake.learn.settings import Collection, Settings
from manywake.suite import load

if TYPE_CHECKING:
    from manywake.learn.train import Show, Trained


@dataclass(frozen=True)
class OpenRun:
    """A run whose simulation is open: it can be resumed, evaluated and replayed."""

    run: Run
    simulation: Simulation

    @property
    def folder(self) -> Path:
        return self.run.folder


def train(
    case: str | Path | Case = load.DEFAULT,
    task: Task | str | None = None,
    *,
    env: str | None = None,
    learning: Learning | None = None,
    collection: Collection | None = None,
    seed: int = 0,
    run: str | Path | None = None,
    progress: Progress | None = None,
    show: Show | None = None,
    **overrides: Any,
) -> OpenRun:
    """Train a policy into a run folder, and return the run.

    case, task, overrides: as in `manywake.choose`; the learner's settings too can be overridden by name. env: another
    simulation in place of the case, module:factory or an id of Gymnasium. learning, collection: whole sets of settings.
    run: the folder, runs/CASE-sSEED-DATE when not given. progress: called while a baseline is made. show: called with
    each block of episodes that comes.
    """
    simulation: Simulation
    if env is None:
        chosen = load.choose(case, task, **overrides)
        learning, name = learning or chosen.learning, chosen.definition.name
        simulation = flows.open_flows(chosen, progress)
    else:
        horizon = overrides.pop("actions", external.HORIZON)
        simulation, name = external.open_simulation(env, horizon, os.getcwd()), env
        learning = replace(learning or Learning(), **overrides)
    folder = Path(run) if run is not None else folder_for(name, seed)
    train_into(folder, simulation, Settings(learning, collection or Collection(), seed), show)
    return OpenRun(Run(folder), simulation)


def folder_for(name: str, seed: int) -> Path:
    """Return the folder of a run that was given none."""
    return Path("runs") / f"{re.sub('[:/]', '-', name)}-s{seed}-{time.strftime('%Y%m%d-%H%M%S')}"


def train_into(folder: Path, simulation: Simulation, settings: Settings, show: Show | None = None) -> Trained:
    """Train on any simulation, with the layout and the engine that the settings ask for."""
    how = settings.collection
    grid = layout(how, settings.learning.update_period)
    with engine(how, grid) as where:  # its workers start while the learner is loaded
        from manywake.learn import train

        return train.train(folder, simulation, settings, where, grid, show or train.quiet)


def resume(opened: OpenRun, show: Show | None = None, **where: Any) -> Trained:
    """Go on with a training that was stopped or killed, to the same bits as if it had not been.

    where: settings of `Collection` in place of the run's own, of those that change no result: engine, address, workers,
    lanes, time_limit.
    """
    how, begun = opened.run.settings.collection, opened.run.layout
    moved = "workers" in where or "lanes" in where
    workers, lanes = (None, None) if moved else (begun.workers, begun.lanes)
    address = how.address if where.get("engine", how.engine) == "ray" else None
    how = replace(how, envs=begun.environments, **{"workers": workers, "lanes": lanes, "address": address, **where})
    grid = layout(how, opened.run.settings.learning.update_period)
    with engine(how, grid) as chosen:
        from manywake.learn import train

        return train.resume(opened.folder, opened.simulation, chosen, grid, show or train.quiet, how.time_limit)


def evaluate(run: OpenRun | str | Path, checkpoint: str = "last", workers: int = 2) -> Evaluated:
    """Return what a run's deterministic policy achieves. checkpoint: last or best. workers: threads that play it."""
    from manywake.learn import checkpoints

    opened = run if isinstance(run, OpenRun) else load_run(run)
    with closing(Threads(workers)) as where:
        return opened.simulation.evaluate(checkpoints.policy(opened.run, checkpoint), where)


def judge(
    case: str | Path | Case = load.DEFAULT,
    task: Task | str | None = None,
    *,
    controller: str | Callable[..., Any] = "none",
    numbers: Sequence[float] | None = None,
    workers: int = 2,
    progress: Progress | None = None,
    **overrides: Any,
) -> Evaluation | Evaluations:
    """Return what a controller without a training achieves.

    case, task, overrides: as in `manywake.choose`. controller: none, constant, harmonic or feedback; pretrained, the
    policy that ships with the case; a function (observation, info) -> action, or a class whose objects are such
    functions, one for each flow; or such by name, module:function. numbers: of a simple one, those of the case's file
    when not given. workers: threads that play it.
    """
    simulation = flows.open_flows(load.choose(case, task, **overrides), progress)
    with closing(Threads(workers)) as where:
        return simulation.judge(controller_of(simulation, controller, numbers), where)


def controller_of(
    simulation: flows.Flows, controller: str | Callable[..., Any], numbers: Sequence[float] | None = None
) -> controllers.Controller:
    """Return a controller of a simulation's flows by its name, or of a function; ValueError at the door."""
    if not isinstance(controller, str):
        return controllers.Own(controller)
    if ":" in controller:
        return controllers.own(controller)
    definition = simulation.chosen.definition
    if controller == "pretrained":
        return controllers.shipped(definition.policy, definition.name, simulation.spaces()[0].shape[0])
    known = definition.controllers
    chosen = known.get(controller, ()) if numbers is None else numbers
    return controllers.simple(controller, chosen, simulation.spaces()[1].shape[0])


def search(
    case: str | Path | Case = load.DEFAULT,
    task: Task | str | None = None,
    *,
    controller: str = "constant",
    rounds: int = 8,
    seed: int = 0,
    workers: int = 2,
    progress: Progress | None = None,
    **overrides: Any,
) -> controllers.Found:
    """Return the best numbers of a simple controller, by differential evolution.

    case, task, overrides: as in `manywake.choose`. controller: constant, harmonic or feedback. rounds: generations
    after the first. seed: of the search. workers: threads that play.
    """
    simulation = flows.open_flows(load.choose(case, task, **overrides), progress)
    report = progress or (lambda what, share: None)
    with closing(Threads(workers)) as where:
        return controllers.search(simulation, controller, where, rounds, seed, report)


def load_run(
    folder: str | Path,
    case: str | Path | Case | None = None,
    task: Task | str | None = None,
    *,
    env: str | None = None,
    **overrides: Any,
) -> OpenRun:
    """Open a run folder; nothing in it is run, and no module or file that it names.

    So a run of a user's own case wants `case` (and `task`, if it was made in Python) again, and compares it with what
    the run recorded; one of another simulation wants `env`. overrides: those that were given as objects.
    """
    run = Run(Path(folder))
    described = run.described()
    if described["simulation"].get("kind") == external.KIND:
        about = checked(described["simulation"], external.Described, run.path)
        return OpenRun(run, external.reopen(run.folder, about, env))
    about = checked(described["simulation"], flows.Described, run.path)
    if case is None and not (about["shipped"] and about["name"] in load.names()):
        raise ValueError(
            f"case: {run.folder} was made with its user's own ({about['file'] or 'made in Python'}), which is not run "
            "because a folder names it; give it again: --case FILE, or case=..., task=... in Python"
        )
    case, task = about["name"] if case is None else case, about["protocol"] if task is None else task
    try:
        chosen = load.choose(case, task, **{**about["overrides"], **overrides})
    except TypeError as error:
        if overrides:
            raise  # it may be one of these
        raise ValueError(f"run: {run.path} is damaged: its overrides have a value of another type ({error})") from error
    return OpenRun(run, flows.reopen(run.folder, about, described["kept"], chosen))


def load_policy(path: str | Path) -> Policy:
    """Return the policy of a run: policy(observation) is its action without noise. It reads numbers, and runs nothing.

    path: a run's folder, for its newest policy, or one of the files in its `versions`; neither needs torch. Or one of
    its checkpoints. Observations are flat, as a flow's environment gives them, (values,) or (B, values). Actions are
    not cut to the action space; a flow's environment does that.
    """
    path = Path(path)
    if path.suffix == ".zip":
        from manywake.learn import checkpoints

        return checkpoints.read(path)
    return policies.read(path) if path.suffix == ".npz" else Run(path).newest_version()


def layout(how: Collection, period: int) -> blocks.Layout:
    """Return how the environments are spread."""
    return blocks.layout(how.envs, how.workers, how.lanes, period, usable_cores())


def engine(how: Collection, grid: blocks.Layout) -> closing[Engine]:
    """Return the engine that the settings ask for, for a with statement that closes it."""
    if how.engine == "ray":
        from manywake.learn.ray_engine import Ray

        return closing(Ray(grid.workers, how.address, how.cpus_per_env))
    if how.engine == "processes":
        return closing(Processes(grid.workers))
    return closing(Threads(1 if how.engine == "serial" else grid.workers))
