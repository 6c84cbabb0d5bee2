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
    """Return the columns of a table of numbers, none when it is empty or not there."""
    table = read(path)
    return {name: np.array([float(row[name]) for row in table]) for name in (table[0] if table else ())}


def untimed(table: list[dict[str, str]]) -> list[tuple[str, ...]]:
    """Return the rows of a table without their times: what must be the same to the bit however it was come by."""
    return [tuple(value for name, value in row.items() if not name.endswith("_s")) for row in table]


def cut(path: Path, updates: int | None = None, rows: int = 0) -> None:
    """Drop what was cut short, and the rows of updates past the first `updates`, to be made again.

    rows: those of an update. ValueError where some of the first updates are missing.
    """
    if not path.exists():
        return
    text = path.read_text(errors="replace")
    reader = csv.DictReader(io.StringIO(text[: text.rfind("\n") + 1]))
    kept = list(reader)
    if kept and updates is not None:
        wanted = {str(k) for k in range(updates)}
        kept = [row for row in kept if row.get("update") in wanted and None not in row.values()]
        first = min((int(row["update"]) for row in kept), default=0)  # past 0 in a table that was begun anew
        if len(kept) != (updates - first) * rows:
            raise ValueError(
                f"run: {path} has {len(kept)} whole rows of updates {first} to {updates - 1}, wanted "
                f"{(updates - first) * rows}; bring them back, or delete the file to go on without them"
            )
    if not kept:
        path.unlink()
        return
    out = io.StringIO()
    writer = csv.DictWriter(out, reader.fieldnames or ())
    writer.writeheader()
    writer.writerows(kept)
    disk.write(path, lambda file: file.write(out.getvalue().encode()))
