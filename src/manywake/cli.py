"""The command line: manywake validate | baseline | train | resume | evaluate | replay | figure | bench.

Strings become objects here.
"""

import dataclasses
import importlib
import json
import os
import shutil
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, get_args

import tyro
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from manywake.env.task import Task
from manywake.flow import baseline, case
from manywake.flow.baseline import Baseline
from manywake.flow.case import CASES
from manywake.learn.collect import Layout, layout
from manywake.learn.engine import Engine
from manywake.learn.settings import PROTOCOLS, Collection, Learning, Settings

console = Console(stderr=True)

CaseName = Annotated[str, tyro.conf.arg(help=f"Which flow: {', '.join(CASES)}.")]
Json = Annotated[bool, tyro.conf.arg(help="Print one JSON object as the last line.")]


def _progress(*columns: str) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        *(TextColumn(f"{{task.fields[{name}]}}") for name in columns),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
    )


class _Bar:
    """Shows progress(what, share) as a bar for each work under way, and a line for each that was done meanwhile."""

    def __init__(self) -> None:
        self.progress = Progress(TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), console=console)
        self.tasks: dict[str, tuple[TaskID, float]] = {}

    def __call__(self, what: str, share: float) -> None:
        if share < 1.0:
            if what not in self.tasks:
                self.tasks[what] = self.progress.add_task(what, total=1.0), time.perf_counter()
            self.progress.update(self.tasks[what][0], completed=share)
        elif what in self.tasks:
            task, begun = self.tasks.pop(what)
            self.progress.remove_task(task)
            console.print(f"{what}: {time.perf_counter() - begun:.0f} s", highlight=False)


def _baseline(chosen: case.Case) -> Baseline:
    """Return the baseline of a case, with a bar if it has to be made."""
    bar = _Bar()
    with bar.progress:
        return baseline.get(chosen, bar)


@dataclass(frozen=True)
class Validate:
    """Check the solver against published references, on the mesh and time step that training uses."""

    case: CaseName = "cylinder-jets"
    recompute: bool = False
    """Also recompute the reference of the controlled flows: twice as fine a mesh, half the time step (10 minutes)."""
    json: Json = False

    def run(self) -> int:
        from manywake.flow import validate

        bar = _Bar()
        with bar.progress:
            checks = validate.run(case.by_name(self.case), bar, recompute=self.recompute)
        table = Table("quantity", "ours", "reference", "tolerance", "pass", "source", title=f"validate {self.case}")
        for check in checks:
            table.add_row(
                check.name,
                f"{check.ours:.6g}",
                f"{check.reference:.6g}",
                _tolerance(check),
                "[green]yes[/]" if check.passed else "[red]NO[/]",
                check.source,
            )
        Console().print(table)
        passed = all(check.passed for check in checks)
        if self.json:
            rows = [{**dataclasses.asdict(check), "passed": check.passed} for check in checks]
            print(json.dumps({"passed": passed, "checks": rows}))
        return 0 if passed else 1


def _tolerance(check) -> str:
    if check.kind == "relative":
        return f"{check.tolerance:.2%}"
    return f"{check.tolerance:.3g}" if check.kind == "absolute" else check.kind


@dataclass(frozen=True)
class BaselineCommand:
    """Describe the baseline of a case (mesh, start state, mean flow), check its hash, or make it again."""

    case: CaseName = "cylinder-jets"
    make: Path | None = None
    """Make it anew and write it to this file."""
    json: Json = False

    def run(self) -> int:
        chosen = case.by_name(self.case)
        if self.make is None:
            base = _baseline(chosen)
        else:
            bar = _Bar()
            with bar.progress:
                base = baseline.make(chosen, progress=bar)
            baseline.save(base, self.make)
        described = {
            "case": self.case,
            "flow_digest": base.flow_digest,
            "digest": base.digest(),
            "recipe": base.recipe,
            "check": "content matches its hash and its case",
            "triangles": len(base.mesh.triangles),
            **dataclasses.asdict(base.shedding),
            "strouhal": base.shedding.strouhal(chosen.diameter),
            "cd_steady": base.cd_steady,
            "cl_steady": base.cl_steady,
        }
        _print(described, self.json)
        return 0


@dataclass(frozen=True)
class Evaluate:
    """Play a run's deterministic policy against the uncontrolled flow."""

    run_folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
    checkpoint: Literal["last", "best"] = "last"
    workers: int = 2
    """Threads that advance flows."""
    json: Json = False

    def run(self) -> int:
        numbers = _evaluate(self.run_folder, self.checkpoint, self.workers)
        _report(numbers)
        if self.json:
            print(json.dumps(numbers))
        return 0


def _evaluate(folder: Path, checkpoint: str, workers: int) -> dict:
    from manywake import plots
    from manywake.learn import evaluate, runs
    from manywake.learn.engine import Threads
    from manywake.learn.rollout import JetFlows

    run = runs.Run(folder)
    simulation = run.simulation()
    if not isinstance(simulation, JetFlows):
        raise ValueError(f"evaluate: {folder} is of {run.settings.env!r}; wanted a run of a cylinder's flow")
    engine = Threads(workers)
    try:
        with console.status("evaluating: deterministic policy, 4 episode lengths, 8 phases of shedding"):
            result = evaluate.evaluate(simulation, run.policy(checkpoint), engine)
    finally:
        engine.close()
    numbers = result.summary()
    tail = "" if checkpoint == "last" else f"-{checkpoint}"
    runs.write_json(folder / f"evaluation{tail}.json", numbers)
    ops, base = simulation.operators, simulation.baseline
    plots.learning_curve(runs.read_episodes(folder), base, folder / "learning-curve.png")
    plots.wake(ops, base, result, simulation.task.max_flow_rate, folder / f"wake{tail}.png")
    return numbers


def _report(numbers: dict) -> None:
    table = Table("", "one episode", "long run", "worst of 8 phases", title="deterministic policy, second halves")
    worst = min(numbers["phases"], key=lambda control: -1.0 if control["diverged"] else control["drag_reduction"])
    for key, label, style in (
        ("cd_uncontrolled", "C_D uncontrolled", ".4f"),
        ("cd_controlled", "C_D controlled", ".4f"),
        ("drag_reduction", "drag reduction", ".2%"),
        ("share_of_shedding_drag", "share of the shedding drag removed", ".1%"),
        ("cl_mean", "C_L mean", "+.3f"),
        ("cl_rms", "C_L rms", ".3f"),
        ("jet_rms", "jet rms / limit", ".1%"),
    ):
        cells = (numbers, numbers["long_run"], worst)
        table.add_row(label, *("blew up" if row["diverged"] else format(row[key], style) for row in cells))
    Console().print(table)


def _engine(how: Collection, plan: Layout) -> Engine:
    from manywake.learn.engine import Processes, Threads

    if how.engine == "ray":
        from manywake.learn.ray_engine import Ray

        return Ray(plan.workers, how.address, how.cpus_per_env)
    if how.engine == "processes":
        return Processes(plan.workers)
    return Threads(1 if how.engine == "serial" else plan.workers)


def _layout(how: Collection, period: int) -> Layout:
    found = layout(how.envs, how.workers, how.lanes, period)
    console.print(f"{found}; {how.engine}; {how.schedule}, {how.clock} clock", soft_wrap=True)
    return found


def _watched(work, folder: Path, total: int, done: int, as_json: bool, evaluated: bool) -> int:
    """Run a training with a progress bar, then evaluate it; work(show) trains."""
    from manywake.learn import runs

    with _progress("shares", "numbers") as progress:
        bar = progress.add_task("episodes", total=total, completed=done, shares="", numbers="")

        def show(episodes, shares, failures) -> None:
            progress.update(
                bar,
                advance=len(episodes),
                numbers=_numbers(episodes, failures),
                shares=_shares(dataclasses.asdict(shares)),
            )

        try:
            trained = work(show)
        except KeyboardInterrupt:
            progress.stop()
            if (folder / "settings.json").exists():
                console.print(f"stopped; what was learnt is kept, go on with: manywake resume {folder}")
            else:
                console.print("stopped before there was anything to keep")
            return 130
    numbers = dataclasses.asdict(trained)
    runs.write_json(folder / "training.json", numbers)
    if evaluated:
        numbers = {**_evaluate(folder, "last", 2), **numbers}
        _report(numbers)
        for share, when in trained.reached.items():
            text = "not reached" if when is None else f"{when[0]} episodes, {when[1] / 60:.1f} min"
            console.print(f"while exploring, {float(share):.1%} drag reduction after: {text}")
    else:
        numbers["reward_last_update"] = float(runs.read_episodes(folder)["reward"][-20:].mean())
        console.print(f"mean reward of the last 20 episodes {numbers['reward_last_update']:.4g}")
    if trained.failures:
        console.print(f"{trained.failures} blocks of episodes were lost and played again: {folder / 'failures.csv'}")
    console.print(f"trained in {trained.wall_time_s / 60:.1f} min; policy {trained.policy_sha256[:16]}; see {folder}")
    if as_json:
        print(json.dumps(numbers))
    return 0


def _numbers(episodes, failures: int) -> str:
    whole = [episode for episode in episodes if not episode.terminated] or episodes
    lost = f" lost {failures}" if failures else ""
    if not all({"c_d", "c_l"} <= set(episode.readings) for episode in whole):
        return f"reward {sum(e.rewards.sum() for e in whole) / len(whole):.4g}{lost}"
    means = [sum(e.readings[name][len(e.rewards) // 2 :].mean() for e in whole) / len(whole) for name in ("c_d", "c_l")]
    return f"C_D {means[0]:.3f} C_L {means[1]:+.3f}{lost}"


def _shares(seconds: dict[str, float]) -> str:
    total = sum(seconds.values())
    return " ".join(f"{name} {value / total:.0%}" for name, value in seconds.items() if value > total / 200)


@dataclass(frozen=True)
class TrainCommand:
    """Train a policy, evaluate it, and leave a run folder with checkpoints, tables and pictures."""

    task: tyro.conf.OmitArgPrefixes[Task]
    learning: tyro.conf.OmitArgPrefixes[Learning]
    collection: tyro.conf.OmitArgPrefixes[Collection]
    case: CaseName = "cylinder-jets"
    env: str | None = None
    """Another simulation in place of the case: module:factory, or an id registered with Gymnasium."""
    protocol: Literal["default", "paper", "code"] = "default"
    """Which defaults the other settings have: ours, the paper's, or those of the paper's released code."""
    seed: int = 0
    run_folder: Annotated[Path | None, tyro.conf.arg(name="run", metavar="DIR")] = None
    """Run folder; default runs/<case>-s<seed>-<date>."""
    json: Json = False

    def run(self) -> int:
        plan = _layout(self.collection, self.learning.update_period)
        engine = _engine(self.collection, plan)  # its workers start while the learner is loaded
        try:
            from manywake.learn import train

            settings = Settings(
                case.by_name(self.case), self.task, self.learning, self.collection, self.seed, self.env, os.getcwd()
            )
            stamp = time.strftime("%Y%m%d-%H%M%S")
            name = self.case if self.env is None else self.env.replace(":", "-").replace("/", "-")
            folder = self.run_folder or Path("runs") / f"{name}-s{self.seed}-{stamp}"
            if self.env is None:
                settings.task.steps(settings.case.time_step)
                cd_uncontrolled = _baseline(settings.case).shedding.cd_mean
                console.print(f"run folder {folder}; uncontrolled C_D {cd_uncontrolled:.4f}")
            else:
                console.print(f"run folder {folder}")
            return _watched(
                lambda show: train.train(folder, settings, engine, plan, show),
                folder,
                self.learning.episodes,
                0,
                self.json,
                self.env is None,
            )
        finally:
            engine.close()


@dataclass(frozen=True)
class Resume:
    """Go on with a training that was stopped or killed, to the same bits as if it had not been.

    Where it runs may differ from where it began: the options below take the place of the run's own.
    """

    run_folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
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
        from manywake.learn import runs, train

        run = runs.Run(self.run_folder)
        settings = run.settings
        how = settings.collection
        engine_name = self.engine or how.engine
        address = self.address or (how.address if engine_name == "ray" else None)
        limit = self.time_limit or how.time_limit
        how = dataclasses.replace(how, engine=engine_name, address=address, time_limit=limit)
        moved = self.workers is not None or self.lanes is not None
        how = dataclasses.replace(
            how,
            envs=run.layout.environments,
            workers=self.workers if moved else run.layout.workers,
            lanes=self.lanes if moved else run.layout.lanes,
        )
        plan = _layout(how, settings.learning.update_period)
        engine = _engine(how, plan)
        try:
            done = runs.newest(run)[1].version * settings.learning.update_period
            return _watched(
                lambda show: train.resume(self.run_folder, engine, plan, show, limit),
                self.run_folder,
                settings.learning.episodes,
                done,
                self.json,
                settings.env is None,
            )
        finally:
            engine.close()


@dataclass(frozen=True)
class ReplayCommand:
    """Play one episode of a run again, alone, with the policies it was played by, and compare it with its record."""

    run_folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
    episode: Annotated[int, tyro.conf.Positional]
    json: Json = False

    def run(self) -> int:
        from manywake.learn import runs, train

        result = train.replay(runs.Run(self.run_folder), self.episode)
        described = {
            "episode": self.episode,
            "versions": sorted(set(result.episode.versions.tolist())),
            **result.numbers,
            "same_as_recorded": result.same,
        }
        _print(described, self.json)
        return 1 if result.same is False else 0


PaperFigure = Literal[
    "configuration",
    "timescales",
    "synced",
    "overparallel",
    "cheating",
    "action-period",
    "smoothing",
    "shares",
    "controlled-wake",
]
"""The experiments, in an order in which those come first whose trainings others use."""
FigureName = Literal[PaperFigure, "staleness"]
"""The paper's, and ours."""
BY_PROTOCOL = ("synced", "overparallel", "staleness", "cheating", "action-period", "smoothing", "shares")
"""Those that train by the paper's protocol, and so can by that of its released code."""


@dataclass(frozen=True)
class Figure:
    """Rerun an experiment: train what is not trained yet, write its tables, draw its figure from them.

    All are those of the paper's figures; staleness is ours. Trainings are kept in runs/figures, so that an interrupted
    command goes on where it was; tables go to experiments/results, pictures to docs/figures. What each shows and costs:
    the head of experiments/NAME.py.
    """

    name: Annotated[FigureName | Literal["all"], tyro.conf.Positional]
    replot: bool = False
    """Draw from the tables alone."""
    protocol: Literal["paper", "code"] = "paper"
    """The paper's, or that of its released code (linear ramp, its reward), whose files have -code in their names."""
    fresh: bool = False
    """Delete the trainings of this experiment first."""
    miniature: bool = False
    """Everything in seconds, into runs/miniature; the numbers mean nothing."""
    json: Json = False

    def run(self) -> int:
        Setup = _script("figure", "experiments", "experiment").Setup
        checkout, runs = Path(__file__).parents[2], Path("runs") / ("miniature" if self.miniature else "figures")
        results, figures = checkout / "experiments" / "results", checkout / "docs" / "figures"
        if self.miniature:
            results, figures = runs / "results", runs / "pictures"
        if self.protocol == "code" and self.name not in (*BY_PROTOCOL, "all"):
            raise ValueError(f"protocol: {self.name} does not depend on it; wanted one of {', '.join(BY_PROTOCOL)}")
        every = [name for name in get_args(PaperFigure) if self.protocol == "paper" or name in BY_PROTOCOL]
        names = every if self.name == "all" else (self.name,)
        scripts = {name: _script("figure", "experiments", name.replace("-", "_")) for name in names}
        found = {}
        bar = _Bar()
        with bar.progress:
            setup = Setup(runs, results, figures, self.protocol, self.miniature, bar)
            if self.fresh and not self.replot:
                for name in names:
                    shutil.rmtree(runs / f"{name}{setup.tail}", ignore_errors=True)
            if self.name == "all" and not self.replot:
                _train_all(setup, scripts.values())
            for name, script in scripts.items():
                started = time.perf_counter()
                if not self.replot:
                    script.run(setup)
                script.plot(setup)
                found[name] = script.summary(setup)
                minutes = (time.perf_counter() - started) / 60
                console.print(f"{name}: {minutes:.1f} min; {setup.csv(name)}, {setup.png(name)}", soft_wrap=True)
        if self.json:
            print(json.dumps(found))
        else:
            Console().print_json(json.dumps(found))
        return 0


def _train_all(setup, scripts) -> None:
    """Train what all experiments ask for, together, so that no core waits for the end of one of them."""
    started = time.perf_counter()
    sets = [script.wanted(setup) for script in scripts if hasattr(script, "wanted")]
    wanted = [training for series in sets for group in series.values() for training in group]
    _script("figure", "experiments", "trainings").train_all(setup, wanted)
    console.print(f"all trainings: {(time.perf_counter() - started) / 60:.1f} min")


def _script(command: str, folder: str, name: str):
    """Return a script of the checkout; ValueError when the package is installed without one."""
    path = Path(__file__).parents[2] / folder
    if not path.exists():
        raise ValueError(f"{command}: {path} is not there; {folder} are of the source checkout, not of the package")
    if str(path) not in sys.path:
        sys.path.insert(0, str(path))
    return importlib.import_module(name)


@dataclass(frozen=True)
class Bench:
    """Measure, with the scripts in benchmarks/.

    step: milliseconds per flow and time step, forces, probes and control law included. roofline: each kernel beside
    what this core's arithmetic and memory allow. cost: time and memory of a flow against the number of triangles.
    scaling: speed-up of collection with the number of environments (half an hour, mostly asleep). peers: the paper's
    scheme in FEniCS, as written and tuned, and in scikit-fem, beside ours (what is installed; ten minutes).
    """

    what: Annotated[Literal["step", "roofline", "cost", "scaling", "peers"], tyro.conf.Positional]
    lanes: tuple[int, ...] = (1, 8, 16, 32)
    """Batch widths that step measures."""
    json: Json = False

    def run(self) -> int:
        script = _script("bench", "benchmarks", self.what)
        _print(script.measure(self.lanes) if self.what == "step" else script.measure(), self.json)
        return 0


def _print(numbers: dict, as_json: bool) -> None:
    if as_json:
        print(json.dumps(numbers))
        return
    table = Table("", "")
    for key, value in numbers.items():
        table.add_row(key, f"{value:.6g}" if isinstance(value, float) else str(value))
    Console().print(table)


def _interrupt(number, frame) -> None:
    raise KeyboardInterrupt


def main() -> None:
    """Run the command line."""
    # a batch system's polite request to stop is treated as Ctrl-C
    signal.signal(signal.SIGTERM, _interrupt)
    # the protocol chooses the defaults that the other options then override, so it is looked at first
    words = [part for word in sys.argv[1:] for part in word.split("=", 1)]
    named = dict(zip(words, words[1:], strict=False)).get("--protocol", "default")
    name = named if named in PROTOCOLS else "default"
    defaults = TrainCommand(*PROTOCOLS[name], Collection(), protocol=name)  # type: ignore[arg-type]
    try:
        chosen = tyro.cli(
            Annotated[Validate, tyro.conf.subcommand("validate")]
            | Annotated[BaselineCommand, tyro.conf.subcommand("baseline")]
            | Annotated[TrainCommand, tyro.conf.subcommand("train", default=defaults)]
            | Annotated[Resume, tyro.conf.subcommand("resume")]
            | Annotated[Evaluate, tyro.conf.subcommand("evaluate")]
            | Annotated[ReplayCommand, tyro.conf.subcommand("replay")]
            | Annotated[Figure, tyro.conf.subcommand("figure")]
            | Annotated[Bench, tyro.conf.subcommand("bench")],  # type: ignore[arg-type]
            prog="manywake",
            description="Active flow control by deep reinforcement learning, on many simulations at once.",
        )
        sys.exit(chosen.run())
    except KeyboardInterrupt:
        console.print("stopped")
        sys.exit(130)
    except (ValueError, RuntimeError, OSError) as error:
        console.print(f"[red]error:[/] {error}", highlight=False, soft_wrap=True)
        sys.exit(2)


if __name__ == "__main__":
    main()
