"""Tables of a run as CSV: a row an update, an episode, a lost block. Read without torch."""

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np

from manywake.machine import disk


def append(path: Path, rows: list[dict[str, Any]]) -> None:
    """Append rows to a table, with its header if it is new; its first row's columns are the table's."""
    header = None
    if path.exists() and path.stat().st_size:
        with open(path, newline="") as file:
            header = next(csv.reader(file))
    with open(path, "a", newline="") as file:
        writer = csv.DictWriter(file, header or list(rows[0]), restval="nan", extrasaction="ignore")
        if header is None:
            writer.writeheader()
        writer.writerows(rows)


def read(path: Path) -> list[dict[str, str]]:
    """Return the rows of a table, none when it is not there."""
    if not path.exists():
        return []
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def columns(path: Path) -> dict[str, np.ndarray]:
    """Return the columns of a table of numbers."""
    table = read(path)
    return {name: np.array([float(row[name]) for row in table]) for name in table[0]}


def untimed(table: list[dict[str, str]]) -> list[tuple[str, ...]]:
    """Return the rows of a table without their times: what must be the same to the bit however it was come by."""
    return [tuple(value for name, value in row.items() if not name.endswith("_s")) for row in table]


def cut(path: Path, version: int | None) -> None:
    """Drop the rows of a table that are of updates from `version` on, to be made again, and what was cut short."""
    text = path.read_text() if path.exists() else ""
    header, *table = list(csv.reader(io.StringIO(text[: text.rfind("\n") + 1]))) or [[]]
    if not table:
        path.unlink(missing_ok=True)
        return
    kept = table if version is None else [row for row in table if int(row[header.index("update")]) < version]
    out = io.StringIO()
    csv.writer(out).writerows([header, *kept])
    disk.write(path, lambda file: file.write(out.getvalue().encode()))
