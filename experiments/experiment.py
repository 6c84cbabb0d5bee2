"""What every experiment is given: folders, protocol, and its tables as CSV."""

import csv
import io
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from manywake.machine import disk

Table = dict[str, np.ndarray]
"""Columns by name: numbers, or text where there is any."""


@dataclass(frozen=True)
class Setup:
    """Where an experiment keeps what it makes, and how large it is.

    runs: a folder per training. results: the tables. figures: the pictures. protocol: paper, or that of its released
    code, code. miniature: everything in seconds, with numbers that mean nothing.
    """

    runs: Path
    results: Path
    figures: Path
    protocol: str = "paper"
    miniature: bool = False
    progress: Callable[[str, float], None] = lambda what, share: None

    @property
    def tail(self) -> str:
        """Return what tells the files of another protocol apart."""
        return "" if self.protocol == "paper" else f"-{self.protocol}"

    def csv(self, name: str) -> Path:
        return self.results / f"{name}{self.tail}.csv"

    def png(self, name: str) -> Path:
        self.figures.mkdir(parents=True, exist_ok=True)
        return self.figures / f"{name}{self.tail}.png"


def write(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Write a table, whole or not at all; the first row's keys are the columns."""
    out = io.StringIO()
    writer = csv.DictWriter(out, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    disk.write(path, lambda file: file.write(out.getvalue().encode()))


def read(path: Path) -> Table:
    """Read what `write` wrote; ValueError when it is not there."""
    if not path.exists():
        raise ValueError(f"results: {path} is not there; run the experiment first, without --replot")
    with open(path, newline="") as file:
        rows = list(csv.DictReader(file))
    return {name: _column([row[name] for row in rows]) for name in rows[0]}


def _column(values: list[str]) -> np.ndarray:
    try:
        return np.array([float(value) for value in values])
    except ValueError:
        return np.array(values)


def where(table: Table, **wanted: Any) -> Table:
    """Return the rows whose columns have the wanted values."""
    rows = np.ones(len(next(iter(table.values()))), dtype=bool)
    for name, value in wanted.items():
        rows &= table[name] == value
    return {name: column[rows] for name, column in table.items()}


def names(table: Table, column: str = "series") -> list:
    """Return the values of a column, each once, in the order they come."""
    return list(dict.fromkeys(table[column].tolist()))


def rounded(row: dict[str, Any], digits: int = 4) -> dict[str, Any]:
    """Return a row with its numbers rounded, so that tables stay small."""
    return {key: round(float(value), digits) if isinstance(value, float) else value for key, value in row.items()}


def spread(values: Iterable[float]) -> tuple[float, float]:
    """Return mean and standard deviation over the seeds (0 of a single one)."""
    array = np.array(list(values), dtype=float)
    return float(array.mean()), float(array.std(ddof=1)) if len(array) > 1 else 0.0
