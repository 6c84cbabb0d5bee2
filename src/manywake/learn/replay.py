"""One episode of a run played again, alone and in this process, by the policies it was played by."""

from dataclasses import dataclass

import numpy as np

from manywake.learn import rows, tables
from manywake.learn.rollout import Episode, Simulation, context
from manywake.learn.runs import Run
from manywake.learn.settings import Settings
from manywake.learn.train import plan


@dataclass(frozen=True)
class Replay:
    """An episode played again.

    recorded: its row in episodes.csv, if it got there. same: whether all its numbers but the times agree to the bit.
    """

    episode: Episode
    numbers: dict[str, float]
    recorded: dict[str, str] | None
    same: bool | None


def replay(run: Run, simulation: Simulation, index: int) -> Replay:
    """Play one episode of a run again. simulation: what the run played, opened again."""
    settings = run.settings
    recorded = {int(row["episode"]): row for row in tables.read(run.folder / "episodes.csv")}.get(index)
    asks = _played_by(run, settings, index, recorded, simulation.horizon)
    versions, which = np.unique(asks, return_inverse=True)
    own = context(settings.seed, index, simulation.horizon, simulation.spaces()[1].shape[0], which)
    episode = simulation.play([run.version(int(version)) for version in versions], [own])[0]
    numbers = rows.played(simulation, episode)
    same = None
    if recorded is not None:
        same = all(recorded[name] == str(value) for name, value in numbers.items() if name in recorded)
    return Replay(episode, numbers, recorded, same)


def _played_by(run: Run, settings: Settings, index: int, recorded: dict[str, str] | None, horizon: int) -> np.ndarray:
    """Return the versions (asks,) an episode was, or would have been, played by, one after the other."""
    if not 0 <= index < settings.learning.episodes:
        raise ValueError(f"episode: got {index}, wanted one of the run's {settings.learning.episodes}")
    planned = plan(settings, run.layout, horizon)
    if planned is not None:
        return planned.version[index]
    if recorded is not None:
        return np.array([int(recorded["version"])])
    for row in reversed(tables.read(run.folder / "failures.csv")):
        if str(index) in row["episodes"].split():
            return np.array([int(row["version"])])
    raise ValueError(f"episode: got {index}, which was not begun; wanted one of episodes.csv or failures.csv")
