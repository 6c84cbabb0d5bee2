"""manywake train, manywake resume: a training with its bar, and what it came to."""

import dataclasses
import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from manywake import api
from manywake.case.learning import Learning
from manywake.cli import options
from manywake.cli.flow import CaseName
from manywake.cli.runs import Env, File, RunFolder, evaluated
from manywake.cli.show import Bar, Episodes, Json, say
from manywake.learn import external, flows
from manywake.learn.rollout import Simulation
from manywake.learn.runs import Run
from manywake.learn.settings import Collection, Settings
from manywake.suite import load
from manywake.suite.load import Definition


def train_command(definition: Definition, name: str, protocol_name: str) -> type:
    """Return the command, with the settings of a case under one of its protocols as the defaults of its options."""
    learnt = definition.protocol(protocol_name)[1]
    Protocol: Any = Literal[tuple(definition.protocols)]

    Own: Any = options.settings(definition, protocol_name, task=True)

    @dataclass(frozen=True)
    class Train:
        """Train a policy, evaluate it, and leave a run folder with checkpoints, tables and pictures."""

        settings: tyro.conf.OmitArgPrefixes[Own]
        """Settings of the case, as its file has them, and of its task."""
        learning: tyro.conf.OmitArgPrefixes[Learning] = learnt
        collection: tyro.conf.OmitArgPrefixes[Collection] = Collection()
        case: CaseName = name
        env: str | None = None
        """Another simulation in place of the case: module:factory, or an id registered with Gymnasium."""
        protocol: Protocol = protocol_name
        """Which defaults the other settings have, of those that the case's file names."""
        seed: int = 0
        """Seed of the run: of the first weights, the exploration and the minibatches."""
        run_folder: Annotated[Path | None, tyro.conf.arg(name="run", metavar="DIR")] = None
        """Run folder; default runs/<case>-s<seed>-<date>."""
        json: Json = False

        def run(self) -> int:
            """Train."""
            return _train(definition, self)

    return Train


def _train(definition: Definition, asked: Any) -> int:
    folder = asked.run_folder or api.folder_for(asked.env or definition.name, asked.seed)
    simulation: Simulation
    if asked.env is None:
        chosen = load.override(definition, asked.protocol, options.overrides(asked.settings))
        with Bar() as bar:
            simulation = flows.open_flows(chosen, bar)
    else:
        actions = options.overrides(asked.settings).get("actions", external.HORIZON)
        simulation = external.open_simulation(asked.env, actions, os.getcwd())
    settings = Settings(asked.learning, asked.collection, asked.seed)
    _say_layout(settings.collection, settings.learning.update_period)
    say(f"run folder {folder}")
    opened = api.OpenRun(Run(folder), simulation)
    return _watched(
        lambda show: api.train_into(folder, simulation, settings, show),
        opened,
        settings.learning.episodes,
        0,
        asked.json,
    )


def _say_layout(how: Collection, period: int) -> None:
    say(f"{api.layout(how, period)}; {how.engine}; {how.schedule}, {how.clock} clock")


def _watched(work: Callable[..., Any], opened: api.OpenRun, total: int, done: int, as_json: bool) -> int:
    """Run a training with a progress bar, then evaluate it; work(show) trains."""
    from manywake.learn import runs

    folder, bar = opened.folder, Episodes(total, done)
    with bar.progress:
        try:
            trained = work(bar.show)
        except KeyboardInterrupt:
            bar.progress.stop()
            if (folder / "settings.json").exists():
                say(f"stopped; what was learnt is kept, go on with: manywake resume {folder}")
            else:
                say("stopped before there was anything to keep")
            return 130
    numbers = dataclasses.asdict(trained)
    runs.write_json(folder / "training.json", numbers)
    numbers = {**evaluated(opened, "last", 2), **numbers}
    for share, when in trained.reached.items():
        if when is not None:
            say(f"while exploring, {float(share):.1%} gained after: {when[0]} episodes, {when[1] / 60:.1f} min")
    if trained.failures:
        say(f"{trained.failures} blocks of episodes were lost and played again: {folder / 'failures.csv'}")
    say(f"trained in {trained.wall_time_s / 60:.1f} min; policy {trained.policy_sha256[:16]}; see {folder}")
    if as_json:
        print(json.dumps(numbers))
    return 0


@dataclass(frozen=True)
class Resume:
    """Go on with a training that was stopped or killed, to the same bits as if it had not been.

    Where it runs may differ from where it began: the options below take the place of the run's own.
    """

    run_folder: RunFolder
    case: File = None
    env: Env = None
    engine: Literal["processes", "serial", "threads", "ray"] | None = None
    """Where episodes are played."""
    address: str | None = None
    """Address of a running Ray cluster."""
    workers: int | None = None
    """Processes, threads or tasks at once."""
    lanes: int | None = None
    """Environments that a worker advances side by side."""
    time_limit: float | None = None
    """Seconds that a block may take until its worker is replaced."""
    json: Json = False

    def run(self) -> int:
        """Go on."""
        from manywake.learn import checkpoints

        opened = api.load_run(self.run_folder, self.case, env=self.env)
        learning = opened.run.settings.learning
        names = ("engine", "address", "workers", "lanes", "time_limit")
        where = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
        done = checkpoints.newest(opened.run)[1].version * learning.update_period
        return _watched(lambda show: api.resume(opened, show, **where), opened, learning.episodes, done, self.json)
