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
    """Return the whole rows of a table, none when it is not there."""
    if not path.exists():
        return []
    return _whole(path)[1]


def _whole(path: Path) -> tuple[list[str], list[dict[str, str]]]:
    """Return the columns of a table and its rows, without what was cut short."""
    text = path.read_text(errors="replace")
    reader = csv.DictReader(io.StringIO(text[: text.rfind("\n") + 1]))
    rows = [row for row in reader if None not in row and None not in row.values()]
    return list(reader.fieldnames or ()), rows


def columns(path: Path) -> dict[str, np.ndarray]:
    """Return the columns of a table of numbers, none when it is empty or not there; ValueError when it is damaged."""
    table = read(path)
    try:
        return {name: np.array([float(row[name]) for row in table]) for name in (table[0] if table else ())}
    except ValueError as error:
        raise ValueError(f"run: {path} is damaged ({error}); bring it back, or delete it to go on without it") from None


def untimed(table: list[dict[str, str]]) -> list[tuple[str, ...]]:
    """Return the rows of a table without their times: what must be the same to the bit however it was come by."""
    return [tuple(value for name, value in row.items() if not name.endswith("_s")) for row in table]


def check(path: Path, updates: int, rows: int) -> None:
    """Raise ValueError where a table lacks rows of the first `updates`, of which each has so many.

    A table that is not there, or has no whole row, lacks none: it is begun anew, and from then on counts from its first
    update.
    """
    table = read(path)
    if not table:
        return
    kept = _of_the_first(table, updates)
    first = min((int(row["update"]) for row in kept), default=0)
    if len(kept) != (updates - first) * rows:
        raise ValueError(
            f"run: {path} has {len(kept)} whole rows of updates {first} to {updates - 1}, wanted "
            f"{(updates - first) * rows}; bring them back, or delete the file to go on without them"
        )


def cut(path: Path, updates: int | None = None) -> None:
    """Drop what was cut short, and the rows of updates past the first `updates`, to be made again."""
    if not path.exists():
        return
    header, kept = _whole(path)
    kept = kept if updates is None else _of_the_first(kept, updates)
    if not kept:
        path.unlink()
        return
    out = io.StringIO()
    writer = csv.DictWriter(out, header)
    writer.writeheader()
    writer.writerows(kept)
    disk.write(path, lambda file: file.write(out.getvalue().encode()))


def _of_the_first(table: list[dict[str, str]], updates: int) -> list[dict[str, str]]:
    wanted = {str(k) for k in range(updates)}
    return [row for row in table if row.get("update") in wanted]
