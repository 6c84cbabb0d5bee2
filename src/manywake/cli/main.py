"""The command line's entry: strings become objects, errors one line."""

import os
import signal
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from manywake.cli import options
from manywake.cli.flow import baseline_command, validate_command
from manywake.cli.runs import Evaluate, Replay
from manywake.cli.show import console, say
from manywake.cli.training import Resume, train_command
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


def _commands(words: list[str]) -> Any:
    """Return all commands; those that take a case with the settings of the one that the words name."""
    asked = options.first(words[1:] if words[:1] in (["train"], ["validate"], ["baseline"]) else [])
    definition = load.load(asked.case)
    chosen = {
        "validate": validate_command(definition, asked.case),
        "baseline": baseline_command(definition, asked.case),
        "train": train_command(definition, asked.case, asked.protocol),
        "resume": Resume,
        "evaluate": Evaluate,
        "replay": Replay,
        "figure": Figure,
        "bench": Bench,
    }
    union: Any = None
    for name, command in chosen.items():
        part: Any = Annotated[command, tyro.conf.subcommand(name)]  # type: ignore[valid-type]
        union = part if union is None else union | part
    return union


def _interrupt(number, frame) -> None:
    raise KeyboardInterrupt


def main() -> None:
    """Run the command line."""
    # a batch system's polite request to stop is treated as Ctrl-C
    signal.signal(signal.SIGTERM, _interrupt)
    words = sys.argv[1:]
    try:
        if words[:1] and words[0] in PACKAGES:
            _hand_over(words[0], words[1:])
        chosen = tyro.cli(
            _commands(words),
            prog="manywake",
            description="Active flow control by deep reinforcement learning, on many simulations at once.",
        )
        sys.exit(chosen.run())
    except KeyboardInterrupt:
        say("stopped")
        sys.exit(130)
    except (ValueError, RuntimeError, OSError) as error:
        console.print("[red]error:[/] ", end="")
        say(str(error))
        sys.exit(2)
