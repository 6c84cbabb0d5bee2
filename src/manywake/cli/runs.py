"""manywake train, resume, evaluate, replay: what makes a run, and what its policy does."""

import dataclasses
import json
import os
import shlex
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from manywake import api
from manywake.case.learning import Learning
from manywake.cli import show
from manywake.cli.flow import OnCase
from manywake.cli.show import Bar, Episodes, Json, console, say
from manywake.learn import controllers, external, flows, milestones, runs
from manywake.learn.engine import Threads
from manywake.learn.rollout import Simulation
from manywake.learn.runs import Run, write_json
from manywake.learn.settings import Collection, Settings
from manywake.learn.watch import NAME, Watch

Watching = Annotated[bool, tyro.conf.arg(help=f"Keep {NAME} in the run folder up to date while it trains.")]


@dataclass(frozen=True)
class GivenLearning(Learning):
    """Settings of the learner."""

    def __post_init__(self) -> None:
        """Refuse nothing: `Learning` does it, in words that the parser would replace by its own."""


@dataclass(frozen=True)
class GivenCollection(Collection):
    """How episodes are collected."""

    def __post_init__(self) -> None:
        """Let `Collection` refuse it."""


@dataclass(frozen=True)
class Train(OnCase):
    """Train a policy, evaluate it, and leave a run folder with checkpoints, tables and pictures."""

    learning: tyro.conf.OmitArgPrefixes[GivenLearning] = GivenLearning()
    collection: tyro.conf.OmitArgPrefixes[GivenCollection] = GivenCollection()
    env: str | None = None
    """Another simulation in place of the case: module:factory, or an id registered with Gymnasium."""
    protocol: str = "default"
    """Which defaults the other settings have, of those that the case's file names."""
    seed: int = 0
    """Seed of the run: of the first weights, the exploration and the minibatches."""
    run_folder: Annotated[Path | None, tyro.conf.arg(name="run", metavar="DIR")] = None
    """Run folder; default runs/<case>-s<seed>-<date>."""
    watch: Watching = False

    def run(self) -> int:
        learning, how = Learning(**vars(self.learning)), Collection(**vars(self.collection))
        settings = Settings(learning, how, self.seed)
        folder = self.run_folder or api.folder_for(self.env or self.definition.name, self.seed)
        simulation: Simulation
        if self.env is None:
            chosen = self.chosen(self.protocol)
            with Bar() as bar:
                simulation = flows.open_flows(chosen, bar)
        else:
            actions = self.overrides().get("actions", external.HORIZON)
            simulation = external.open_simulation(self.env, actions, os.getcwd())
        say(f"{api.layout(how, learning.update_period)}; {how.engine}; {how.schedule}, {how.clock} clock")
        say(f"run folder {folder}")
        opened = api.OpenRun(Run(folder), simulation)
        return _trained(lambda shown: api.train_into(folder, simulation, settings, shown), opened, learning, 0, self)


@dataclass(frozen=True)
class OnRun:
    """A command on a run."""

    run_folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
    """Run folder, as manywake train left it."""
    _: KW_ONLY
    case: Path | None = None
    """The case file of the run, if it was a user's own; its hash is compared."""
    env: str | None = None
    """The simulation that the run was made with, if it was made with --env."""
    json: Json = False

    def opened(self) -> api.OpenRun:
        return api.load_run(self.run_folder, self.case, env=self.env)


def of_flow(opened: api.OpenRun) -> flows.Flows:
    """Return the flows of an open run; ValueError where it is one of another simulation."""
    if not isinstance(opened.simulation, flows.Flows):
        raise ValueError(f"run: {opened.folder} was made with --env, wanted one of a flow, whose fields are known")
    return opened.simulation


@dataclass(frozen=True)
class Resume(OnRun):
    """Go on with a training that was stopped or killed, to the same bits as if it had not been.

    Where it runs may differ from where it began: the options below take the place of the run's own.
    """

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
    watch: Watching = False

    def run(self) -> int:
        from manywake.learn import checkpoints

        opened = self.opened()
        if differ := runs.changed(opened.run):
            say(f"not the versions that the run was made with: {differ}; its numbers may change in their last digits")
        learning = opened.run.settings.learning
        names = ("engine", "address", "workers", "lanes", "time_limit")
        where = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
        done = checkpoints.newest(opened.run)[1].version * learning.update_period
        return _trained(lambda shown: api.resume(opened, shown, **where), opened, learning, done, self)


@dataclass(frozen=True)
class Evaluate(OnRun):
    """Play a run's deterministic policy, for a flow against the uncontrolled one.

    Without a run: manywake evaluate --case NAME --controller none|constant|harmonic|feedback|module:function, or
    --pretrained for the policy that ships with the case; --help beside them lists their options.
    """

    checkpoint: Literal["last", "best"] = "last"
    """Which policy: the last, or the one whose episodes had the best mean reward."""
    workers: int = 2
    """Threads that play."""

    def run(self) -> int:
        _evaluated(self.opened(), self.checkpoint, self.workers, self.json)
        return 0


@dataclass(frozen=True)
class OnController(OnCase):
    """A command on flows under a controller of no run."""

    controller: str = "none"
    """none, constant, harmonic, feedback; or module:function, (observation, info) -> action."""
    pretrained: bool = False
    """Play the policy that ships with the case."""
    numbers: tuple[float, ...] | None = None
    """Numbers of a simple controller, as a search gave them; those of the case's file when not given."""
    protocol: str = "default"
    """Which defaults the other settings have, of those that the case's file names."""

    def opened(self) -> tuple[flows.Flows, controllers.Controller]:
        with Bar() as bar:
            simulation = flows.open_flows(self.chosen(self.protocol), bar)
        word = "pretrained" if self.pretrained else self.controller
        return simulation, api.controller_of(simulation, word, self.numbers)


@dataclass(frozen=True)
class EvaluateController(OnController):
    """Play a controller of no run, for a flow against the uncontrolled one."""

    workers: int = 2
    """Threads that play."""

    def run(self) -> int:
        simulation, chosen = self.opened()
        with closing(Threads(self.workers)) as where, console.status("evaluating"):
            found = simulation.judge(chosen, where)
        show.table(found.table())
        if self.json:
            print(json.dumps(found.summary()))
        return 0


@dataclass(frozen=True)
class Search(OnCase):
    """Search for the best numbers of a simple controller: the largest mean reward of an episode's second half."""

    controller: Literal["constant", "harmonic", "feedback"] = "constant"
    """constant: actions are held. harmonic: sines of one frequency. feedback: of the lift and its rate of change."""
    rounds: int = 8
    """Generations of the differential evolution, after the first."""
    seed: int = 0
    """Seed of the search."""
    protocol: str = "default"
    """Which defaults the other settings have, of those that the case's file names."""
    workers: int = 2
    """Threads that play."""

    def run(self) -> int:
        with Bar() as bar, closing(Threads(self.workers)) as where:
            simulation = flows.open_flows(self.chosen(self.protocol), bar)
            found = controllers.search(simulation, self.controller, where, self.rounds, self.seed, bar)
        numbers = " ".join(f"{number:.6g}" for number in found.numbers)
        said = {"case": self.case, "protocol": self.protocol, "controller": self.controller} | self.overrides()
        words = [word for name, value in said.items() for word in (f"--{name.replace('_', '-')}", *_words(value))]
        say(f"at full length: manywake evaluate {shlex.join(words)} --numbers {numbers}")
        show.numbers(dataclasses.asdict(found), self.json)
        return 0


def _words(value: Any) -> list[str]:
    """Return the words of an option's value."""
    return [word for part in value for word in _words(part)] if isinstance(value, tuple | list) else [str(value)]


@dataclass(frozen=True)
class Replay(OnRun):
    """Play one episode of a run again, alone, with the policies it was played by, and compare it with its record."""

    episode: Annotated[int, tyro.conf.Positional]
    """Its number, from 0."""

    def run(self) -> int:
        from manywake.learn.replay import replay

        opened = self.opened()
        result = replay(opened.run, opened.simulation, self.episode)
        versions = sorted(set(result.episode.versions.tolist()))
        described = {"episode": self.episode, "versions": versions, **result.numbers, "same_as_recorded": result.same}
        show.numbers(described, self.json)
        return 1 if result.same is False else 0


def _trained(
    work: Callable[..., Any], opened: api.OpenRun, learning: Learning, done: int, asked: Train | Resume
) -> int:
    """Run a training with a progress bar, and a picture where one is asked for, then evaluate it; work(show) trains."""
    folder = opened.folder
    with ExitStack() as stack:
        bar = stack.enter_context(Episodes(learning.episodes, done))
        watch = stack.enter_context(Watch(folder, learning.episodes)) if asked.watch else None
        shows = [bar.show] if watch is None else [bar.show, watch.show]
        try:
            trained = work(lambda *block: [show(*block) for show in shows])
        except KeyboardInterrupt:
            bar.stop()
            kept = f"stopped; what was learnt is kept, go on with: manywake resume {folder}"
            say(kept if (folder / "settings.json").exists() else "stopped before there was anything to keep")
            return 130
    if watch is not None and watch.problem is not None:
        say(f"{folder / NAME} could not be drawn: {watch.problem}")
    numbers = dataclasses.asdict(trained)
    write_json(folder / "training.json", numbers)
    if isinstance(opened.simulation, flows.Flows) and opened.simulation.chosen.case.bodies:
        numbers["held"] = _held(opened.run, opened.simulation)
        write_json(folder / "training.json", numbers)
    if trained.failures:
        say(f"{trained.failures} blocks of episodes were lost and played again: {folder / 'failures.csv'}")
    _evaluated(opened, "last", 2, asked.json, numbers)
    if spent := bar.spent():
        say(f"time went to: {spent}")
    say(f"trained in {trained.wall_time_s / 60:.1f} min; policy {trained.policy_sha256[:16]}; see {folder}")
    return 0


def _held(run: Run, simulation: flows.Flows) -> dict[str, tuple[int, float] | None]:
    """Say and return from when on the policy without noise held a drag reduction."""
    with console.status("playing the policy of each update"), closing(Threads(2)) as where:
        found = milestones.held(run, milestones.gains(run, simulation, where))
    for share, when in found.items():
        if when is not None:
            say(f"without noise {float(share):.1%} less drag from {when[0]} episodes on, {when[1] / 60:.1f} min")
    return found


def _evaluated(
    opened: api.OpenRun, checkpoint: str, workers: int, as_json: bool, also: dict[str, Any] | None = None
) -> None:
    """Evaluate a run's policy; show what came out, as JSON with `also` too, then keep it and draw it."""
    from manywake.learn import checkpoints

    if checkpoint == "last" and (name := checkpoints.newest(opened.run)[0]) != checkpoint:
        say(f"{opened.run.checkpoints / 'last.zip'} is not whole; {name}.zip was taken")
    with console.status("evaluating the deterministic policy"):
        found = api.evaluate(opened, checkpoint, workers)
    tail = "" if checkpoint == "last" else f"-{checkpoint}"
    numbers = found.summary()
    show.table(found.table())
    if as_json:
        print(json.dumps({**numbers, **(also or {})}), flush=True)
    write_json(opened.folder / f"evaluation{tail}.json", numbers)
    found.draw(opened.folder, tail)
