"""Recorded episodes, for a page that no server stands behind: python -m manywake.play.record FOLDER.

The page is the same; `static/demo.js` plays what is written here. A recording is the length of its description (4
bytes, the lowest first), the description as JSON, then all fields, packed by zlib: of each driver a frame after the
other, row by row from the top. Levels are halved to 7 bits, and in each row kept as changes from the left, modulo 256.
"""

import json
import struct
import sys
import zlib
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from manywake.learn import flows
from manywake.play import layout
from manywake.play.pair import NONE, POLICY, Pair
from manywake.play.picture import Picture
from manywake.suite import load

CASES = {"cylinder-jets": 224, "free-cylinder-rotation": 160, "pinball": 160}
"""What is recorded, on a grid of how many points across."""
LENGTH = 40.0
"""Of a recording, in L/U."""
DRIVERS = (NONE, "constant", POLICY)
EVERY = 0.25
"""About the time between frames, in L/U."""
LARGEST = 2_000_000
"""Bytes of a recording."""


def main(folder: Path) -> None:
    """Write the page and its recordings into a folder."""
    page(folder)
    known = []
    for name, width in CASES.items():
        simulation = flows.open_flows(load.choose(name))
        written = recording(simulation, LENGTH, width)
        if len(written) > LARGEST:
            raise RuntimeError(f"record: {name} takes {len(written)} bytes, wanted at most {LARGEST}; record less")
        (folder / f"{name}.wake").write_bytes(written)
        known.append({"name": name, "reynolds": simulation.chosen.case.reynolds})
        (folder / "cases.json").write_text(json.dumps(known) + "\n")
        print(f"{name}: {len(written) / 1e6:.2f} MB", flush=True)


def page(folder: Path) -> None:
    """Write the page as it is where no server runs."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in viewer().items():
        (folder / name).write_text(content)


def viewer() -> dict[str, str]:
    """Return the files of that page by name."""
    static = Path(str(files("manywake.play") / "static"))
    found = {path.name: path.read_text() for path in static.iterdir()}
    found["index.html"] = found["index.html"].replace('data-source="live"', 'data-source="demo"')
    return found


def recording(simulation: flows.Flows, length: float, width: int) -> bytes:
    """Return recorded episodes of all drivers that a case has, of a length in L/U."""
    picture, numbers, fields = Picture(simulation.flows[0], width), {}, []
    for by in DRIVERS:
        pair = Pair(simulation)
        if by in pair.controllers:
            numbers[by], frames = _played(pair, picture, by, length)
            halved = frames >> 1
            fields.append(np.diff(halved, axis=2, prepend=np.zeros_like(halved[:, :, :1])))  # bytes wrap around
    about: dict[str, Any] = {
        "width": picture.view.width,
        "height": picture.view.height,
        "frames": len(frames),
        "interval": pair.interval / _parts(pair),
        "drivers": list(numbers),
        "numbers": numbers,
        "layout": {
            **layout.described(pair, picture),
            "case": simulation.chosen.definition.name,
            "drivers": list(numbers),
            "reynolds_range": [pair.flow.case.reynolds] * 2,
            "run": None,
            "scored": None,
        },
    }
    about["layout"]["fields"] = about["layout"]["fields"][:1]
    said = json.dumps(about, allow_nan=False).encode()
    return struct.pack("<I", len(said)) + said + zlib.compress(np.concatenate(fields).tobytes(), 9)


def _parts(pair: Pair) -> int:
    return max(1, round(pair.interval / EVERY))


def _played(pair: Pair, picture: Picture, by: str, length: float) -> tuple[list[list[float | None]], np.ndarray]:
    """Return the numbers of each frame, as a page has them, and the driven flow's vorticity, (frames, h, w)."""
    pair.drive(by)
    parts, moved = _parts(pair), np.zeros(len(pair.mixing))
    rows: list[list[float | None]] = []
    frames: list[np.ndarray] = []

    def row() -> list[float | None]:
        found = [len(rows) * pair.interval / parts, *pair.numbers(moved.tolist())[1:]]
        return [round(value, 4) if np.isfinite(value) else None for value in found]

    def keep(amplitudes: np.ndarray) -> None:
        nonlocal moved
        moved = amplitudes
        rows.append(row())
        frames.append(picture.levels(picture.shades[0], pair.states[1]))

    keep(moved)
    for _ in range(round(length / pair.interval)):
        if pair.act(parts, keep):
            raise RuntimeError(f"record: {pair.simulation.chosen.definition.name} blew up under {by}")
        rows.pop()
        rows.append(row())  # what the action brought is known now
    return rows, np.stack(frames)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
