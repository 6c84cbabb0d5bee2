"""Checkpoints: the policy as a plain SB3 zip with what is needed to go on, written whole, read without code."""

import io
import json
import pickle
import zipfile
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from manywake.learn import policy as policies
from manywake.learn import ppo
from manywake.learn.policy import Policy
from manywake.learn.ppo import EpisodicPPO
from manywake.learn.runs import Run
from manywake.machine import disk

DAMAGE = (*disk.DAMAGE, RuntimeError, pickle.UnpicklingError)
"""What reading a damaged checkpoint raises."""


@dataclass
class Progress:
    """What of a training is neither policy nor optimiser: kept in the checkpoint, to go on from there."""

    version: int = 0
    pending: list[tuple[int, int]] = field(default_factory=list)
    wall_s: float = 0.0
    best: float = -np.inf
    best_version: int = 0
    burst: int = 0


def save(model: EpisodicPPO, progress: Progress, run: Run, name: str) -> None:
    """Write a plain SB3 zip, with what else is needed to go on, whole or not at all."""
    buffer = io.BytesIO()
    model.save(buffer)
    with zipfile.ZipFile(buffer, "a") as archive:
        archive.writestr("manywake.json", json.dumps(asdict(progress)))
    disk.write(run.checkpoints / f"{name}.zip", lambda file: file.write(buffer.getvalue()))


def checkpoint(run: Run, model: EpisodicPPO, progress: Progress) -> None:
    """Write the policy version and the newest checkpoint; the one before stays as previous.zip."""
    policies.write(ppo.snapshot(model), run.version_path(model.version))
    last = run.checkpoints / "last.zip"
    if last.exists():
        last.replace(run.checkpoints / "previous.zip")
    save(model, progress, run, "last")


def policy(run: Run, name: str = "last") -> Policy:
    """Return the policy of a checkpoint, last or best; where the last is damaged, of the one before.

    Only tensors are read, no pickle. ValueError when it is not there, or not whole.
    """
    if name == "last":
        name = newest(run)[0]
    return read(run.checkpoints / f"{name}.zip")


def read(path: Path) -> Policy:
    """Return the policy of a checkpoint's file; ValueError when it is not there, or not whole."""
    if not path.exists():
        there = sorted(other.stem for other in path.parent.glob("*.zip"))
        raise ValueError(f"checkpoint: {path} is not there; wanted one of {there}")
    try:
        return ppo.from_state(_read(path)[1])
    except DAMAGE as error:
        raise ValueError(f"checkpoint: {path} is damaged ({error}); wanted a whole one") from error


def _read(path: Path) -> tuple[Progress, dict[str, Any], dict[str, Any]]:
    """Return progress, weights and the optimiser's state of a checkpoint: tensors and plain data, no code."""
    with zipfile.ZipFile(path) as archive:
        if (bad := archive.testzip()) is not None:
            raise zipfile.BadZipFile(f"{bad} is damaged")
        data = json.loads(archive.read("manywake.json"))
        data["pending"] = [tuple(pair) for pair in data["pending"]]
        return Progress(**data), _tensors(archive, "policy.pth"), _tensors(archive, "policy.optimizer.pth")


def _tensors(archive: zipfile.ZipFile, name: str) -> dict[str, Any]:
    with archive.open(name) as file:
        return torch.load(file, weights_only=True)


def newest(run: Run) -> tuple[str, Progress, dict[str, Any], dict[str, Any]]:
    """Return name, progress, weights and the optimiser's state of the newest checkpoint that is whole.

    Raises ValueError when there is none.
    """
    problems = []
    for name in ("last", "previous"):
        try:
            return name, *_read(run.checkpoints / f"{name}.zip")
        except DAMAGE as error:
            problems.append(f"{name}.zip: {error}")
    raise ValueError(f"run: {run.folder} has no whole checkpoint ({'; '.join(problems)}); it must be trained anew")


def restore(run: Run, model: EpisodicPPO) -> tuple[str, Progress]:
    """Put the newest whole checkpoint into a model; return its name and progress."""
    name, progress, weights, moments = newest(run)
    model.policy.load_state_dict(weights)
    model.policy.optimizer.load_state_dict(moments)
    model.version = progress.version
    model.num_timesteps = progress.version * model.learning.update_period * model.collector.simulation.horizon
    model._n_updates = progress.version * model.learning.n_epochs
    return name, progress
