"""manywake compare: runs side by side, as a table and a picture."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from manywake.cli import show
from manywake.cli.show import Json, say
from manywake.learn import compare
from manywake.learn.compare import Comparison, Group, Result

STYLES = {"saved": ".2%", "reward": ".4g"}


@dataclass(frozen=True)
class Compare:
    """Compare runs: groups that differ in the seed alone, their means and 95 % intervals, and their learning curves.

    Drag saved and reward are those of evaluation.json: the long run without noise, mean over its starts. Every other
    group is tested against the first (Welch, two-sided) where both have two seeds.
    """

    runs: tyro.conf.Positional[Annotated[tuple[Path, ...], tyro.conf.arg(metavar="RUN [RUN ...]")]]
    """Run folders."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="PNG")] = Path("compare.png")
    """Where the learning curves are drawn."""
    json: Json = False

    def run(self) -> int:
        if not self.runs:
            raise ValueError("compare: got no run, wanted folders made by manywake train")
        found = compare.compare(self.runs)
        found.draw(self.output)
        for group in found.groups:
            show.table(rows(group), f"{group.letter}: {group.name}")
        if found.differences:
            show.table(tests(found), "Welch's test, two-sided")
        for result in (result for group in found.groups for result in group.results if not result.evaluated):
            say(f"{result.folder} is not evaluated; do so with: manywake evaluate {result.folder}")
        say(f"learning curves: {self.output}")
        if self.json:
            print(json.dumps({**found.summary(), "picture": str(self.output)}))
        return 0


def rows(group: Group) -> list[tuple[str, ...]]:
    """Return the table of a group's runs: a row each, then the mean of several."""
    runs = [_row(result) for result in group.results]
    return [
        ("run", "seed", "episodes", "min", "drag saved", "reward"),
        *runs,
        *([_mean(group)] if len(runs) > 1 else []),
    ]


def _row(result: Result) -> tuple[str, ...]:
    if result.blew_up:
        numbers = ["blew up"] * 2
    elif not result.evaluated:
        numbers = ["not evaluated"] * 2
    else:
        known = {name: getattr(result, name) for name in STYLES}
        numbers = ["-" if known[name] is None else format(known[name], style) for name, style in STYLES.items()]
    episodes = str(result.of) if result.episodes == result.of else f"{result.episodes} of {result.of}"
    where = result.folder.name or str(result.folder)
    return where, str(result.seed), episodes, f"{result.minutes:.1f}", *numbers


def _mean(group: Group) -> tuple[str, ...]:
    numbers = []
    for name, style in STYLES.items():
        mean, error = group.interval(name) or (None, None)
        text = "-" if mean is None else format(mean, style)
        numbers.append(text if error is None else f"{text} ± {error:{style.replace('4', '2')}}")
    return "mean ± 95 %", f"{len(group.results)} in all", "", "", *numbers


def tests(found: Comparison) -> list[tuple[str, ...]]:
    """Return the table of differences between groups."""
    table: list[tuple[str, ...]] = [("groups", "of", "difference", "95 % interval", "p")]
    for one in found.differences:
        style = STYLES[one.measure].replace(".", "+.")
        low, high = (format(end, style) for end in (one.low, one.high))
        p = "no spread" if one.p is None else f"{one.p:.2g}"
        what = compare.MEASURES[one.measure]
        table.append((f"{one.second} - {one.first}", what, format(one.difference, style), f"{low} to {high}", p))
    return table
