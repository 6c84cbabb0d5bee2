"""When a training's policy was good, and stayed so: each version without noise, outside the training's clock."""

from dataclasses import replace

import numpy as np

from manywake.learn import tables
from manywake.learn.engine import Engine
from manywake.learn.rollout import Simulation, context, play
from manywake.learn.runs import Run
from manywake.machine.simd import WIDTHS

MILESTONES = (0.05, 0.07, 0.075)
"""Gains whose first episode is told: drag reductions, for a flow."""


def gains(run: Run, simulation: Simulation, engine: Engine) -> np.ndarray:
    """Return the gain of each version of a run's policy, (versions,), in one episode without noise.

    The episode is none of the training's. NaN where an episode ended early, or where there is no such thing as a gain.
    """
    settings, horizon = run.settings, simulation.horizon
    versions = [int(path.stem) for path in sorted((run.folder / "versions").glob("*.npz"))]
    actions = simulation.spaces()[1].shape[0]
    own = context(settings.seed, settings.learning.episodes, horizon, actions)
    still, shared, futures = np.zeros((horizon, actions)), engine.share(simulation), []
    for first in range(0, len(versions), WIDTHS[0]):
        driving = [run.version(version) for version in versions[first : first + WIDTHS[0]]]
        contexts = [
            replace(own, noise=still, which=np.full(horizon, k, dtype=own.which.dtype)) for k in range(len(driving))
        ]
        futures.append(engine.submit(play, shared, contexts, *driving))
    episodes = [episode for future in futures for episode in future.result()]
    numbers = [np.nan if one.terminated else simulation.gain(simulation.summary(one)) for one in episodes]
    return np.array(numbers, dtype=float)


def held(run: Run, gains: np.ndarray) -> dict[str, tuple[int, float] | None]:
    """Return by milestone the episodes and seconds of training from which on no version gained less; None if never."""
    made = {int(row["update"]) + 1: row for row in tables.read(run.folder / "updates.csv")}
    found: dict[str, tuple[int, float] | None] = {}
    for share in MILESTONES:
        short = np.flatnonzero(~(gains >= share))
        first = int(short[-1]) + 1 if len(short) else 0
        row = made.get(first) if first < len(gains) else None
        found[str(share)] = None if row is None else (int(row["episodes"]), float(row["wall_s"]))
        if first == 0 and len(gains):
            found[str(share)] = (0, 0.0)
    return found
