"""The command line: manywake validate | baseline | train | evaluate | bench. Strings become objects here."""

import dataclasses
import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

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
from manywake.learn.settings import PROTOCOLS, Learning, Settings

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
    """Shows progress(what, share) as a bar per kind of work."""

    def __init__(self) -> None:
        self.progress = Progress(TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), console=console)
        self.tasks: dict[str, TaskID] = {}

    def __call__(self, what: str, share: float) -> None:
        if what not in self.tasks:
            self.tasks[what] = self.progress.add_task(what, total=1.0)
        self.progress.update(self.tasks[what], completed=share)


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
    """Also recompute the reference of the controlled flows: twice as fine a mesh, half the time step (12 minutes)."""
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
            "strouhal": base.shedding.strouhal,
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

    run = runs.Run(folder)
    settings = run.settings
    run.check_baseline()
    engine = Threads(workers)
    with console.status("evaluating: deterministic policy, 4 episode lengths, 8 phases of shedding"):
        result = evaluate.evaluate(settings.case, settings.task, run.policy(checkpoint), engine)
    engine.close()
    numbers = result.summary()
    tail = "" if checkpoint == "last" else f"-{checkpoint}"
    runs.write_json(folder / f"evaluation{tail}.json", numbers)
    ops, base = baseline.assembled(settings.case)
    plots.learning_curve(runs.read_episodes(folder), base, folder / "learning-curve.png")
    plots.wake(ops, base, result, settings.task.max_flow_rate, folder / f"wake{tail}.png")
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


@dataclass(frozen=True)
class Train:
    """Train a policy, evaluate it, and leave a run folder with checkpoints, tables and pictures."""

    task: tyro.conf.OmitArgPrefixes[Task]
    learning: tyro.conf.OmitArgPrefixes[Learning]
    case: CaseName = "cylinder-jets"
    protocol: Literal["default", "paper", "code"] = "default"
    """Which defaults the other settings have: ours, the paper's, or those of the paper's released code."""
    seed: int = 0
    run_folder: Annotated[Path | None, tyro.conf.arg(name="run", metavar="DIR")] = None
    """Run folder; default runs/<case>-s<seed>-<date>."""
    workers: int = 2
    """Threads that advance flows."""
    json: Json = False

    def run(self) -> int:
        from manywake.learn import runs
        from manywake.learn.engine import Threads

        settings = Settings(case.by_name(self.case), self.task, self.learning, self.seed)
        settings.task.steps(settings.case.time_step)
        stamp = time.strftime("%Y%m%d-%H%M%S")
        folder = self.run_folder or Path("runs") / f"{self.case}-s{self.seed}-{stamp}"
        cd_uncontrolled = _baseline(settings.case).shedding.cd_mean
        console.print(f"run folder {folder}; uncontrolled C_D {cd_uncontrolled:.4f}")
        engine = Threads(self.workers)
        with _progress("cd", "cl") as progress:
            bar = progress.add_task("episodes", total=self.learning.episodes, cd="C_D -", cl="C_L -")

            def show(episodes) -> None:
                whole = [e for e in episodes if not e.terminated] or episodes
                cd = sum(e.c_d[len(e.c_d) // 2 :].mean() for e in whole) / len(whole)
                cl = sum(e.c_l[len(e.c_l) // 2 :].mean() for e in whole) / len(whole)
                progress.update(bar, advance=len(episodes), cd=f"C_D {cd:.3f}", cl=f"C_L {cl:+.3f}")

            try:
                trained = runs.train(folder, settings, engine, show)
            finally:
                engine.close()
        runs.write_json(folder / "training.json", dataclasses.asdict(trained))
        numbers = {**_evaluate(folder, "last", self.workers), **dataclasses.asdict(trained)}
        _report(numbers)
        for share, when in trained.reached.items():
            text = "not reached" if when is None else f"{when[0]} episodes, {when[1] / 60:.1f} min"
            console.print(f"while exploring, {float(share):.1%} drag reduction after: {text}")
        console.print(
            f"trained in {trained.wall_time_s / 60:.1f} min; policy {trained.policy_sha256[:16]}; see {folder}"
        )
        if self.json:
            print(json.dumps(numbers))
        return 0


@dataclass(frozen=True)
class Bench:
    """Measure: step = milliseconds per flow and time step, forces, probes and control law included."""

    what: Annotated[Literal["step"], tyro.conf.Positional]
    lanes: tuple[int, ...] = (1, 8, 16, 32)
    """Batch widths to measure."""
    json: Json = False

    def run(self) -> int:
        script = Path(__file__).parents[2] / "benchmarks" / f"{self.what}.py"
        if not script.exists():
            raise ValueError(f"bench: {script} is not there; benchmarks are of the source checkout, not of the package")
        import runpy

        measure = runpy.run_path(str(script))["measure"]
        numbers = measure(self.lanes)
        _print(numbers, self.json)
        return 0


def _print(numbers: dict, as_json: bool) -> None:
    if as_json:
        print(json.dumps(numbers))
        return
    table = Table("", "")
    for key, value in numbers.items():
        table.add_row(key, f"{value:.6g}" if isinstance(value, float) else str(value))
    Console().print(table)


def main() -> None:
    """Run the command line."""
    # the protocol chooses the defaults that the other options then override, so it is looked at first
    words = [part for word in sys.argv[1:] for part in word.split("=", 1)]
    named = dict(zip(words, words[1:], strict=False)).get("--protocol", "default")
    name = named if named in PROTOCOLS else "default"
    defaults = Train(*PROTOCOLS[name], protocol=name)  # type: ignore[arg-type]
    try:
        chosen = tyro.cli(
            Annotated[Validate, tyro.conf.subcommand("validate")]
            | Annotated[BaselineCommand, tyro.conf.subcommand("baseline")]
            | Annotated[Train, tyro.conf.subcommand("train", default=defaults)]
            | Annotated[Evaluate, tyro.conf.subcommand("evaluate")]
            | Annotated[Bench, tyro.conf.subcommand("bench")],  # type: ignore[arg-type]
            prog="manywake",
            description="Active flow control by deep reinforcement learning, on many simulations at once.",
        )
        sys.exit(chosen.run())
    except KeyboardInterrupt:
        console.print("stopped")
        sys.exit(130)
    except (ValueError, RuntimeError) as error:
        console.print(f"[red]error:[/] {error}", highlight=False, soft_wrap=True)
        sys.exit(2)


if __name__ == "__main__":
    main()
