"""The run folder: settings, tables, policy versions, checkpoints."""

import csv
import dataclasses
import io
import json
import pickle
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from filelock import FileLock, Timeout

from manywake.env.task import Task
from manywake.flow import baseline, disk, operators
from manywake.flow.case import Case, Jet, Resolution, Scheme
from manywake.learn import external, ppo
from manywake.learn import policy as policies
from manywake.learn.collect import Layout
from manywake.learn.policy import Policy
from manywake.learn.ppo import EpisodicPPO
from manywake.learn.rollout import JetFlows, Simulation
from manywake.learn.settings import Collection, Learning, Settings

MILESTONES = ("0.05", "0.07", "0.075")
"""Drag reductions whose first episode is written down."""


class Run:
    """A run folder."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.checkpoints = folder / "checkpoints"

    @property
    def settings(self) -> Settings:
        """Return the settings the run was made with; ValueError when the folder is no run."""
        path = self.folder / "settings.json"
        if not path.exists():
            raise ValueError(
                f"run: got {self.folder}, which has no settings.json; wanted a folder made by manywake train"
            )
        data = json.loads(path.read_text())
        return Settings(
            _case(data["case"]),
            Task(**data["task"]),
            Learning(**{**data["learning"], "hidden": tuple(data["learning"]["hidden"])}),
            Collection(**data["collection"]),
            data["seed"],
            data["env"],
            data["env_folder"],
        )

    @property
    def layout(self) -> Layout:
        """Return the layout the run was begun with."""
        return Layout(**json.loads((self.folder / "settings.json").read_text())["layout"])

    def simulation(self) -> Simulation:
        """Return what the run played, from the operators and the baseline it keeps."""
        settings = self.settings
        if settings.env is not None:
            return external.open_simulation(settings.env, settings.task.actions_per_episode, settings.env_folder)
        base = baseline.load(self.folder / "baseline.npz")
        ops = operators.load(self.folder / "operators.npz", settings.case, base.mesh)
        return JetFlows(ops, base, settings.task)

    def policy(self, checkpoint: str = "last") -> Policy:
        """Return the policy of a checkpoint (last or best). Only tensors are read from the zip, no pickle."""
        path = self.checkpoints / f"{checkpoint}.zip"
        if not path.exists():
            raise ValueError(
                f"checkpoint: {path} is not there; wanted one of {sorted(p.stem for p in path.parent.glob('*.zip'))}"
            )
        with zipfile.ZipFile(path) as archive:
            return ppo.from_state(_tensors(archive, "policy.pth"))

    def version_path(self, number: int) -> Path:
        """Return where the policy after `number` updates is kept, for episodes on their way and for replay."""
        return self.folder / "versions" / f"{number:06d}.npz"

    def version(self, number: int) -> Policy:
        """Return the policy after `number` updates; ValueError when the run did not get there."""
        path = self.version_path(number)
        if not path.exists():
            raise ValueError(f"version: got {number}, wanted one of those in {path.parent}")
        return policies.read(path)


def _case(data: dict[str, Any]) -> Case:
    scheme: dict[str, Any] = {
        key: tuple(value) if isinstance(value, list) else value for key, value in data["scheme"].items()
    }
    return Case(
        **{
            **data,
            "jets": tuple(Jet(**jet) for jet in data["jets"]),
            "probes": tuple(tuple(point) for point in data["probes"]),
            "scheme": Scheme(**scheme),
            "resolution": Resolution(**data["resolution"]),
            "x_range": tuple(data["x_range"]),
            "y_range": tuple(data["y_range"]),
        }
    )


def _tensors(archive: zipfile.ZipFile, name: str) -> dict[str, Any]:
    with archive.open(name) as file:
        return torch.load(file, weights_only=True)


@dataclass
class Progress:
    """What of a training is neither policy nor optimiser: kept in the checkpoint, to go on from there."""

    version: int = 0
    pending: list[tuple[int, int]] = dataclasses.field(default_factory=list)
    wall_s: float = 0.0
    best: float = -np.inf
    best_version: int = 0
    burst: int = 0
    reached: dict[str, tuple[int, float] | None] = dataclasses.field(default_factory=lambda: dict.fromkeys(MILESTONES))


def save(model: EpisodicPPO, progress: Progress, path: Path) -> None:
    """Write a plain SB3 zip, with what else is needed to go on, whole or not at all."""
    buffer = io.BytesIO()
    model.save(buffer)
    with zipfile.ZipFile(buffer, "a") as archive:
        archive.writestr("manywake.json", json.dumps(asdict(progress)))
    disk.write(path, lambda file: file.write(buffer.getvalue()))


def checkpoint(run: Run, model: EpisodicPPO, progress: Progress) -> None:
    """Write the policy version and the newest checkpoint; the one before stays as previous.zip."""
    policies.write(ppo.snapshot(model), run.version_path(model.version))
    last = run.checkpoints / "last.zip"
    if last.exists():
        last.replace(run.checkpoints / "previous.zip")
    save(model, progress, last)


def newest(run: Run) -> tuple[str, Progress, dict[str, Any], dict[str, Any]]:
    """Return name, progress, weights and the optimiser's state of the newest checkpoint that is whole.

    Tensors and plain data are read, no code. Raises ValueError when there is none.
    """
    problems = []
    for name in ("last", "previous"):
        path = run.checkpoints / f"{name}.zip"
        try:
            with zipfile.ZipFile(path) as archive:
                bad = archive.testzip()
                if bad is not None:
                    raise zipfile.BadZipFile(f"{bad} is damaged")
                data = json.loads(archive.read("manywake.json"))
                weights, moments = _tensors(archive, "policy.pth"), _tensors(archive, "policy.optimizer.pth")
        except (OSError, EOFError, KeyError, zipfile.BadZipFile, zlib.error, pickle.UnpicklingError) as error:
            problems.append(f"{path.name}: {error}")
            continue
        data["pending"] = [tuple(pair) for pair in data["pending"]]
        return name, Progress(**data), weights, moments
    raise ValueError(f"run: {run.folder} has no whole checkpoint ({'; '.join(problems)}); it must be trained anew")


def restore(run: Run, model: EpisodicPPO) -> Progress:
    """Put the newest whole checkpoint into a model; return its progress."""
    name, progress, weights, moments = newest(run)
    if name == "previous":  # a damaged last would be put in the place of the whole one by the next checkpoint
        (run.checkpoints / "last.zip").unlink(missing_ok=True)
    model.policy.load_state_dict(weights)
    model.policy.optimizer.load_state_dict(moments)
    model.version = progress.version
    model.num_timesteps = progress.version * model.learning.update_period * model.collector.simulation.horizon
    model._n_updates = progress.version * model.learning.n_epochs
    return progress


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


def rows(path: Path) -> list[dict[str, str]]:
    """Return the rows of a table, none when it is not there."""
    if not path.exists():
        return []
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def untimed(table: list[dict[str, str]]) -> list[tuple[str, ...]]:
    """Return the rows of a table without their times: what must be the same to the bit however it was come by."""
    return [tuple(value for name, value in row.items() if not name.endswith("_s")) for row in table]


def cut(path: Path, version: int | None) -> None:
    """Drop the rows of a table that are of updates from `version` on, to be made again, and what was cut short."""
    if not path.exists():
        return
    text = path.read_text()
    lines = list(csv.reader(io.StringIO(text[: text.rfind("\n") + 1])))
    if len(lines) < 2:
        path.unlink()
        return
    header, *table = lines
    kept = table if version is None else [row for row in table if int(row[header.index("update")]) < version]
    out = io.StringIO()
    csv.writer(out).writerows([header, *kept])
    disk.write(path, lambda file: file.write(out.getvalue().encode()))


def write_json(path: Path, data: dict[str, Any]) -> None:
    """Write JSON, whole or not at all."""
    text = json.dumps(data, indent=1, allow_nan=False) + "\n"
    disk.write(path, lambda file: file.write(text.encode()))


def read_episodes(folder: Path) -> dict[str, np.ndarray]:
    """Return the columns of episodes.csv."""
    table = rows(folder / "episodes.csv")
    return {name: np.array([float(row[name]) for row in table]) for name in table[0]}
