"""python -m experiments NAME, or manywake figure NAME."""

import json
import shutil
import time
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any, Literal

import tyro
from rich.console import Console

from experiments import (
    action_period,
    cheating,
    configuration,
    controlled_wake,
    overparallel,
    shares,
    smoothing,
    staleness,
    synced,
    timescales,
    trainings,
)
from experiments.experiment import Setup
from manywake.cli import show
from manywake.cli.show import Bar, Json, say

MODULES = (
    configuration,
    timescales,
    synced,
    overparallel,
    cheating,
    action_period,
    smoothing,
    shares,
    controlled_wake,
    staleness,
)
"""All experiments, in an order in which those come first whose trainings others use.

Each has run(setup), which writes its tables, plot(setup), which draws from them alone, and summary(setup), its numbers.
wanted(setup): the trainings of those that have some. BY_PROTOCOL: of those that train by the paper's protocol, and so
can by that of its released code.
"""
FIGURES = {module.__name__.rpartition(".")[2].replace("_", "-"): module for module in MODULES}
COMMITTED = Path(__file__).parent / "results", Path(__file__).parents[1] / "docs" / "figures"
"""Where the checkout keeps tables and figures."""
OURS = ("staleness",)
"""Figures that are not the paper's, and so not among all."""
BY_PROTOCOL = tuple(name for name, module in FIGURES.items() if hasattr(module, "BY_PROTOCOL"))
ABOUT = "; ".join(f"{name}: {(module.__doc__ or '').splitlines()[0]}" for name, module in FIGURES.items())
Name: Any = Literal[(*FIGURES, "all")]


@dataclass(frozen=True)
class Figure:
    """Rerun an experiment: train what is not trained yet, write its tables, draw its figure from them.

    All are those of the paper's figures; staleness is ours. Everything goes to runs/figures: trainings, which are kept,
    so that an interrupted command goes on where it was; tables, in its folder results; figures, in its folder pictures.
    What each shows and costs: the head of experiments/NAME.py.
    """

    name: Annotated[Name, tyro.conf.Positional, tyro.conf.arg(help=ABOUT)]
    replot: bool = False
    """Draw from tables alone: those of runs/figures, and where it has none those of the checkout."""
    committed: bool = False
    """Write the tables and figures that are committed in the checkout, experiments/results and docs/figures."""
    protocol: Literal["paper", "code"] = "paper"
    """The paper's, or that of its released code (linear ramp, its reward), whose files have -code in their names."""
    fresh: bool = False
    """Delete the trainings of this experiment first."""
    miniature: bool = False
    """Everything in seconds, into runs/miniature; the numbers mean nothing."""
    json: Json = False

    def run(self) -> int:
        """Print the numbers."""
        runs = Path("runs") / ("miniature" if self.miniature else "figures")
        results, figures = runs / "results", runs / "pictures"
        if self.committed:
            results, figures = COMMITTED
            if self.miniature:
                raise ValueError("committed: got it with --miniature, whose numbers mean nothing; wanted one of them")
        if self.protocol == "code" and self.name not in (*BY_PROTOCOL, "all"):
            raise ValueError(f"protocol: {self.name} does not depend on it; wanted one of {', '.join(BY_PROTOCOL)}")
        known = BY_PROTOCOL if self.protocol == "code" else tuple(FIGURES)
        names = [name for name in known if name not in OURS] if self.name == "all" else [self.name]
        found = {}
        with Bar() as bar:
            setup = Setup(runs, results, figures, self.protocol, self.miniature, bar)
            if self.fresh and not self.replot:
                for name in names:
                    shutil.rmtree(runs / f"{name}{setup.tail}", ignore_errors=True)
            if self.name == "all" and not self.replot:
                train_all(setup, [FIGURES[name] for name in names])
            for name in names:
                started, of = time.perf_counter(), setup
                if not self.replot:
                    FIGURES[name].run(of)
                elif not (self.miniature or of.csv(name).exists()):
                    of = replace(setup, results=COMMITTED[0])
                FIGURES[name].plot(of)
                found[name] = FIGURES[name].summary(of)
                minutes = (time.perf_counter() - started) / 60
                say(f"{name}: {minutes:.1f} min; {of.csv(name)}, {of.png(name)}")
        if self.json:
            print(json.dumps(found))
        else:
            Console().print_json(json.dumps(found))
        return 0


def train_all(setup: Setup, modules: Iterable[ModuleType]) -> None:
    """Train what all experiments ask for, together, so that no core waits for the end of one of them."""
    started = time.perf_counter()
    sets = [module.wanted(setup) for module in modules if hasattr(module, "wanted")]
    trainings.train_all(setup, [one for series in sets for group in series.values() for one in group])
    say(f"all trainings: {(time.perf_counter() - started) / 60:.1f} min")


def main() -> None:
    """Run the command."""
    show.ending(lambda: tyro.cli(Figure, prog="manywake figure").run())


if __name__ == "__main__":
    main()
