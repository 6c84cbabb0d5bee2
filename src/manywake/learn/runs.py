"""The run folder: what was played and how, as JSON; the policy versions. Nothing in it is run, no torch is loaded."""

import json
import platform
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypedDict, get_type_hints

from filelock import FileLock, Timeout

from manywake.case.learning import Learning
from manywake.learn import policy as policies
from manywake.learn.blocks import Layout
from manywake.learn.policy import Policy
from manywake.learn.settings import Collection, Settings
from manywake.machine import disk

FORMAT = 3
"""Of settings.json and checkpoints; version 0.1.0 wrote others, without a number."""
RECORDED = ("manywake", "numba", "numpy", "stable-baselines3", "torch")
"""Packages whose versions a run records."""


class _Later(TypedDict):
    """The versions of what a run's numbers depend on, from an update on."""

    from_update: int
    versions: dict[str, str]


class _Described(TypedDict):
    """What settings.json holds. later: the versions that the run was resumed with, where they had changed."""

    format: int
    simulation: dict[str, Any]
    learning: dict[str, Any]
    collection: dict[str, Any]
    seed: int
    layout: dict[str, int]
    kept: dict[str, Any]
    versions: dict[str, str]
    later: list[_Later]


class Run:
    """A run folder: what it was begun with, and the policy after each update."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.path = folder / "settings.json"
        self.checkpoints = folder / "checkpoints"

    def described(self) -> dict[str, Any]:
        """Return what settings.json says; ValueError when the folder is no run, one of another version, or damaged."""
        path = self.path
        if not path.exists():
            wanted = "which has no settings.json; wanted a folder made by manywake train"
            raise ValueError(f"run: got {self.folder}, {wanted}")
        try:
            data = json.loads(path.read_text())
        except ValueError as error:
            raise ValueError(f"run: {path} is damaged ({error})") from error
        if not isinstance(data, dict) or data.get("format") != FORMAT:
            made = data.get("format", "of 0.1.0") if isinstance(data, dict) else "of something else"
            got = f"{path} has format {made}, wanted {FORMAT}"
            raise ValueError(f"run: {got}; install the version that made it, or train anew")
        return checked({"later": []} | data, _Described, path)

    @property
    def settings(self) -> Settings:
        data = self.described()
        learning = _from_plain(Learning, data["learning"], self.path)
        collection = _from_plain(Collection, data["collection"], self.path)
        return Settings(learning, collection, data["seed"])

    @property
    def simulation(self) -> dict[str, Any]:
        """Return how the simulation described itself; `kind` says who can open it again."""
        return self.described()["simulation"]

    @property
    def layout(self) -> Layout:
        return _from_plain(Layout, self.described()["layout"], self.path)

    def version_path(self, number: int) -> Path:
        """Return where the policy after `number` updates is kept, for episodes on their way and for replay."""
        return self.folder / "versions" / f"{number:06d}.npz"

    def newest_version(self) -> Policy:
        """Return the policy after the last update that was made; ValueError where there is none."""
        known = sorted((self.folder / "versions").glob("*.npz"))
        if not known:
            raise ValueError(f"policy: {self.folder} has none, wanted a folder made by manywake train")
        return policies.read(known[-1])

    def version(self, number: int) -> Policy:
        """Return the policy after `number` updates; ValueError when the run did not get there."""
        path = self.version_path(number)
        if not path.exists():
            raise ValueError(f"version: got {number}, wanted one of those in {path.parent}")
        return policies.read(path)


def checked(value: Any, kind: Any, path: Path) -> Any:
    """Return what JSON gave if it is of a type; ValueError with the file it is from and what is amiss."""
    from typeguard import TypeCheckError, check_type  # it takes a tenth of a second to load

    try:
        return check_type(value, kind)
    except TypeCheckError as error:
        raise ValueError(f"run: {path} is damaged, or of another version ({error})") from None


def _from_plain(kind: Any, data: dict[str, Any], path: Path) -> Any:
    """Return a data class of plain fields from what JSON gave."""
    plain = {name: tuple(value) if isinstance(value, list) else value for name, value in data.items()}
    try:
        return kind(**checked(plain, TypedDict(kind.__name__, get_type_hints(kind)), path))  # type: ignore[operator]
    except ValueError as error:
        raise ValueError(str(error) if str(path) in str(error) else f"run: {path}: {error}") from None


def versions() -> dict[str, str]:
    """Return the versions of what a run's numbers depend on."""
    return {name: version(name) for name in RECORDED} | {"python": platform.python_version()}


def changed(run: Run) -> str:
    """Return which versions are not those that the run was last played with; empty where all are."""
    data = run.described()
    before = data["later"][-1]["versions"] if data["later"] else data["versions"]
    pairs = ((name, before.get(name, "?"), now) for name, now in versions().items())
    return ", ".join(f"{name} {then} is {now} now" for name, then, now in pairs if then != now)


def went_on(run: Run, update: int) -> None:
    """Record the versions that a run is resumed with, before which update, where they have changed."""
    if changed(run):
        data = run.described()
        data["later"].append({"from_update": update, "versions": versions()})
        write_json(run.path, data)


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """Hold a run folder for writing; ValueError when that cannot be.

    A new one is gone again where what was to be done in it failed, or was stopped, before there were settings.
    """
    new = not folder.exists()
    try:
        (folder / "checkpoints").mkdir(parents=True, exist_ok=True)
        held = FileLock(folder / ".lock", timeout=0).acquire()
    except Timeout:
        raise ValueError(f"run: {folder} is being written by another training; choose another --run") from None
    except OSError as error:
        raise ValueError(f"run: cannot write {folder} ({error}); choose another --run") from error
    with held:
        try:
            yield
        except BaseException:
            if new and not (folder / "settings.json").exists():
                shutil.rmtree(folder, ignore_errors=True)
            raise


def write_json(path: Path, data: dict[str, Any]) -> None:
    """Write JSON, whole or not at all."""
    text = json.dumps(data, indent=1, allow_nan=False) + "\n"
    disk.write(path, lambda file: file.write(text.encode()))
