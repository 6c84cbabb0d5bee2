"""The command line's entry: strings become objects, errors one line."""

import os
import sys
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, Union

import tyro

from manywake.cli import show
from manywake.cli.comparing import Compare
from manywake.cli.doctor import Doctor
from manywake.cli.exports import Export, ExportCase, ExportPolicy, Movie, MovieCase
from manywake.cli.flow import Baseline, Mesh, Validate, command, first
from manywake.cli.playing import Play
from manywake.cli.runs import Evaluate, EvaluateController, GivenLearning, Replay, Resume, Search, Train
from manywake.suite import load

PACKAGES = {"figure": "experiments", "bench": "benchmarks"}
"""Commands that are packages of the source checkout, with options of their own."""


@dataclass(frozen=True)
class Figure:
    """Rerun an experiment: train, write its tables, draw its figure (manywake figure --help)."""


@dataclass(frozen=True)
class Bench:
    """Measure (manywake bench --help)."""


def _hand_over(command: str, words: list[str]) -> None:
    """Become the package of the checkout that a command is."""
    checkout, package = Path(__file__).parents[3], PACKAGES[command]
    if not (checkout / package).exists():
        raise ValueError(
            f"{command}: {checkout / package} is not there; {package} are of the source checkout, not of the package"
        )
    path = os.pathsep.join(filter(None, [str(checkout), os.environ.get("PYTHONPATH")]))
    os.execve(sys.executable, [sys.executable, "-m", package, *words], os.environ | {"PYTHONPATH": path})


def _of_no_run(words: list[str]) -> bool:
    """Return whether the words play a controller that comes from no run."""
    named = {word.partition("=")[0] for word in words}
    shows = words[:1] in (["export"], ["movie"])
    if shows and "--case" in named and words[1].startswith("-"):
        return True  # a run, which may want its case file, stands first
    return (shows or words[:1] == ["evaluate"]) and not named.isdisjoint(("--controller", "--pretrained"))


def _commands(words: list[str]) -> Any:
    """Return all commands; those that take a case with the settings of the one that the words name."""
    plays = words[:1] in (["train"], ["search"]) or _of_no_run(words)
    asked = first(words[1:] if plays or words[:1] in (["validate"], ["baseline"], ["mesh"]) else [])
    definition = load.load(asked.case)
    commands: tuple[Any, ...] = (
        command(Validate, definition, case=asked.case),
        command(Baseline, definition, case=asked.case),
        command(Mesh, definition, case=asked.case),
        *(Resume, Replay, Compare, ExportPolicy, Doctor, Play, Figure, Bench),
    )
    if not _of_no_run(words):
        commands = (*commands, Evaluate, Export, Movie)
    if asked.protocol in definition.protocols or plays:  # a flow without a task has nothing to learn or to play
        learning = definition.protocol(asked.protocol)[1]
        commands = (command(Train, definition, **vars(asked), learning=GivenLearning(**vars(learning))), *commands)
        commands += (command(Search, definition, **vars(asked)),)
    if _of_no_run(words):
        commands += (command(EvaluateController, definition, "evaluate", **vars(asked)),)
        commands += (command(ExportCase, definition, "export", **vars(asked)),)
        commands += (command(MovieCase, definition, "movie", **vars(asked)),)
    return Union[commands]  # noqa: UP007


def _run() -> int:
    words = sys.argv[1:]
    if words[:1] and words[0] in PACKAGES:
        _hand_over(words[0], words[1:])
    if words == ["--version"]:
        print(f"manywake {metadata.version('manywake')}")
        return 0
    about = "Active flow control by deep reinforcement learning, on many simulations at once. --version: which this is."
    return tyro.cli(_commands(words), prog="manywake", description=about).run()


def main() -> None:
    """Run the command line."""
    show.ending(_run)
