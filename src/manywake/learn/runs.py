"""The run folder: what was played and how, as JSON; the policy versions. Nothing in it is run, no torch is loaded."""

import dataclasses
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from manywake.case.learning import Learning
from manywake.learn import policy as policies
from manywake.learn.blocks import Layout
from manywake.learn.policy import Policy
from manywake.learn.settings import Collection, Settings
from manywake.machine import disk

FORMAT = 2
"""Of settings.json; version 0.1.0 wrote another, without a number."""


class Run:
    """A run folder: what it was begun with, and the policy after each update."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.checkpoints = folder / "checkpoints"

    def described(self) -> dict[str, Any]:
        """Return what settings.json says; ValueError when the folder is no run, or one of another version."""
        path = self.folder / "settings.json"
        if not path.exists():
            wanted = "which has no settings.json; wanted a folder made by manywake train"
            raise ValueError(f"run: got {self.folder}, {wanted}")
        try:
            data = json.loads(path.read_text())
        except ValueError as error:
            raise ValueError(f"run: {path} is damaged ({error})") from error
        if not isinstance(data, dict) or data.get("format") != FORMAT:
            made = data.get("versions", {}).get("manywake", "0.1.0") if isinstance(data, dict) else "something else"
            got = f"{self.folder} was made by manywake {made}, whose runs this version cannot play"
            raise ValueError(f"run: {got}; install that version, or train anew")
        return data

    @property
    def settings(self) -> Settings:
        data = self.described()
        learning, collection = _from_plain(Learning, data["learning"]), _from_plain(Collection, data["collection"])
        return Settings(learning, collection, data["seed"])

    @property
    def simulation(self) -> dict[str, Any]:
        """Return how the simulation described itself; `kind` says who can open it again."""
        return self.described()["simulation"]

    @property
    def layout(self) -> Layout:
        return Layout(**self.described()["layout"])

    def version_path(self, number: int) -> Path:
        """Return where the policy after `number` updates is kept, for episodes on their way and for replay."""
        return self.folder / "versions" / f"{number:06d}.npz"

    def version(self, number: int) -> Policy:
        """Return the policy after `number` updates; ValueError when the run did not get there."""
        path = self.version_path(number)
        if not path.exists():
            raise ValueError(f"version: got {number}, wanted one of those in {path.parent}")
        return policies.read(path)


def _from_plain(kind: Any, data: dict[str, Any]) -> Any:
    """Return a data class of plain fields from what JSON gave."""
    known = {field.name for field in dataclasses.fields(kind)}
    if set(data) != known:
        raise ValueError(f"run: settings.json has {sorted(set(data) ^ known)} more or less than {kind.__name__} has")
    return kind(**{name: tuple(value) if isinstance(value, list) else value for name, value in data.items()})


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """Hold a run folder for writing; ValueError when that cannot be."""
    try:
        (folder / "checkpoints").mkdir(parents=True, exist_ok=True)
        held = FileLock(folder / ".lock", timeout=0).acquire()
    except Timeout:
        raise ValueError(f"run: {folder} is being written by another training; choose another --run") from None
    except OSError as error:
        raise ValueError(f"run: cannot write {folder} ({error}); choose another --run") from error
    with held:
        yield


def write_json(path: Path, data: dict[str, Any]) -> None:
    """Write JSON, whole or not at all."""
    text = json.dumps(data, indent=1, allow_nan=False) + "\n"
    disk.write(path, lambda file: file.write(text.encode()))
