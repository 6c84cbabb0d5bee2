"""The run folder: settings, episodes.csv, TensorBoard events, checkpoints, baseline, evaluation."""

import csv
import json
import os
import platform
import time
import zipfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import torch
from filelock import FileLock, Timeout
from stable_baselines3.common.logger import configure

from manywake.env.env import spaces
from manywake.env.task import Task
from manywake.flow import baseline
from manywake.flow.case import Case, Jet, Resolution, Scheme
from manywake.learn import ppo
from manywake.learn.collect import Collector
from manywake.learn.engine import Engine
from manywake.learn.ppo import EpisodicPPO
from manywake.learn.rollout import Episode
from manywake.learn.settings import Learning, Settings

COLUMNS = (
    "episode", "version", "length", "reward", "c_d", "c_d_second_half", "c_l", "c_l_second_half", "jet_rms",
    "terminated", "flow_s", "policy_s", "wall_s",
)  # fmt: skip
"""Columns of episodes.csv. c_d, c_l: means over the episode and its second half; jet_rms in units of the limit."""


class Run:
    """A run folder. Writing one takes its lock, so that two trainings cannot share it."""

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
            data["seed"],
        )

    def policy(self, checkpoint: str = "last") -> ppo.Policy:
        """Return the policy of a checkpoint (last or best). Only tensors are read from the zip, no pickle."""
        path = self.checkpoints / f"{checkpoint}.zip"
        if not path.exists():
            raise ValueError(
                f"checkpoint: {path} is not there; wanted one of {sorted(p.stem for p in path.parent.glob('*.zip'))}"
            )
        with zipfile.ZipFile(path) as archive, archive.open("policy.pth") as file:
            return ppo.from_state(torch.load(file, weights_only=True))

    def check_baseline(self) -> None:
        """Raise ValueError when the flow of this run is not the one its case has today."""
        kept, today = baseline.load(self.folder / "baseline.npz"), baseline.get(self.settings.case)
        if kept.digest() != today.digest():
            raise ValueError(
                f"run: {self.folder} was made from baseline {kept.digest()[:12]}, "
                f"the case has {today.digest()[:12]} today; "
                "evaluate it with the version of manywake that made it (settings.json has it)"
            )


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


def _model(settings: Settings, engine: Engine) -> EpisodicPPO:
    collector = Collector(engine, settings.case, settings.task, settings.seed)
    return ppo.build(*spaces(settings.case, settings.task), settings.learning, collector)


@dataclass(frozen=True)
class Trained:
    """What a training leaves: wall time and policy hash, and when it first got below shares of the drag.

    reached: drag reduction, of the exploring episodes of an update (second halves, so the noise's drag is in it), ->
    (episodes, seconds), or None.
    """

    wall_time_s: float
    episodes: int
    policy_sha256: str
    reached: dict[str, tuple[int, float] | None]


class Watch(ppo.Hooks):
    """Writes down what a training does: rows of episodes.csv, checkpoints, milestones."""

    def __init__(self, run: Run, settings: Settings, show: Callable[[list[Episode]], None]):
        super().__init__(arrived=show, collected=self._collected)
        self.run, self.settings = run, settings
        self.started = time.perf_counter()
        self.best = -np.inf
        self.cd_uncontrolled = baseline.get(settings.case).shedding.cd_mean
        self.reached: dict[str, tuple[int, float] | None] = {"0.05": None, "0.07": None, "0.075": None}
        with open(run.folder / "episodes.csv", "w", newline="") as file:
            csv.writer(file).writerow(COLUMNS)

    def _collected(self, model: EpisodicPPO, episodes: list[Episode]) -> None:
        wall = time.perf_counter() - self.started
        rows = [_row(episode, self.settings.task, wall) for episode in episodes]
        with open(self.run.folder / "episodes.csv", "a", newline="") as file:
            csv.writer(file).writerows(rows)
        # the policy that played these episodes, before the update made of them
        save(model, self.run.checkpoints / "last.zip")
        score = float(np.mean([episode.rewards.sum() for episode in episodes]))
        if score > self.best:
            self.best = score
            save(model, self.run.checkpoints / "best.zip")
        whole = [row[COLUMNS.index("c_d_second_half")] for row in rows if not row[COLUMNS.index("terminated")]]
        reduction = 1 - np.mean(whole) / self.cd_uncontrolled if whole else 0.0
        for share, when in self.reached.items():
            if when is None and reduction >= float(share):
                self.reached[share] = (episodes[-1].index + 1, wall)


def _row(episode: Episode, task: Task, wall: float) -> list:
    half = len(episode.c_d) // 2
    return [
        episode.index,
        episode.policy_version,
        len(episode.c_d),
        float(episode.rewards.sum()),
        *(float(part.mean()) for part in (episode.c_d, episode.c_d[half:], episode.c_l, episode.c_l[half:])),
        float(np.sqrt(np.mean(episode.jets**2)) / task.max_flow_rate),
        int(episode.terminated),
        round(episode.flow_seconds, 3),
        round(episode.policy_seconds, 3),
        round(wall, 3),
    ]


def save(model: EpisodicPPO, path: Path) -> None:
    """Write a plain SB3 zip, whole or not at all."""
    temporary = path.with_suffix(".partial.zip")
    model.save(temporary)
    os.replace(temporary, path)


def train(
    folder: Path, settings: Settings, engine: Engine, show: Callable[[list[Episode]], None] = lambda episodes: None
) -> Trained:
    """Train into a new run folder; ValueError when it already holds a run or cannot be written."""
    run = Run(folder)
    try:
        run.checkpoints.mkdir(parents=True, exist_ok=True)
        held = FileLock(folder / ".lock", timeout=0).acquire()
    except Timeout:
        raise ValueError(f"run: {folder} is being written by another training; choose another --run") from None
    except OSError as error:
        raise ValueError(f"run: cannot write {folder} ({error}); choose another --run") from error
    with held:
        if (folder / "settings.json").exists():
            raise ValueError(f"run: {folder} already holds a training; choose another --run or delete it")
        ops, base = baseline.assembled(settings.case)
        described = {
            **asdict(settings),
            "baseline": base.digest(),
            "operators": ops.digest,
            "versions": {name: version(name) for name in ("manywake", "numba", "numpy", "stable-baselines3", "torch")},
            "python": platform.python_version(),
        }
        baseline.save(base, folder / "baseline.npz")
        (folder / "settings.json").write_text(json.dumps(described, indent=1) + "\n")
        model = _model(settings, engine)
        model.set_logger(configure(str(folder / "tensorboard"), ["csv", "tensorboard"]))
        watch = Watch(run, settings, show)
        model.hooks = watch
        try:
            model.learn(settings.learning.episodes * settings.task.actions_per_episode)
        finally:
            model.logger.close()
        save(model, run.checkpoints / "last.zip")
        wall = time.perf_counter() - watch.started
    return Trained(wall, settings.learning.episodes, ppo.digest(model), watch.reached)


def write_json(path: Path, data: dict[str, Any]) -> None:
    """Write JSON, whole or not at all."""
    temporary = path.with_suffix(".partial")
    temporary.write_text(json.dumps(data, indent=1, allow_nan=False) + "\n")
    os.replace(temporary, path)


def read_episodes(folder: Path) -> dict[str, np.ndarray]:
    """Return the columns of episodes.csv."""
    with open(folder / "episodes.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    return {name: np.array([float(row[name]) for row in rows]) for name in COLUMNS}
