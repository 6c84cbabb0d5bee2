"""Training into a run folder, going on with one, and playing one of its episodes again."""

import platform
import shutil
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.logger import configure

from manywake.flow import baseline, operators
from manywake.learn import collect, external, ppo, runs, schedule
from manywake.learn.collect import Collector, EpisodeFailed, Failure
from manywake.learn.engine import Engine, Threads
from manywake.learn.ppo import EpisodicPPO
from manywake.learn.rollout import Episode, JetFlows, Simulation, explore
from manywake.learn.runs import Progress, Run
from manywake.learn.schedule import Plan
from manywake.learn.settings import Settings

Show = Callable[[list[Episode], "Shares", int], None]
"""show(episodes, shares, failures): called with each block that comes, where the time went, blocks lost so far."""


@dataclass(frozen=True)
class Trained:
    """What a training leaves: wall time and policy hash, and when it first got below shares of the drag.

    reached: drag reduction, of the exploring episodes of an update (second halves, so the noise's drag is in it), ->
    (episodes, seconds), or None. failures: blocks that were lost and played again.
    """

    wall_time_s: float
    episodes: int
    policy_sha256: str
    reached: dict[str, tuple[int, float] | None]
    failures: int


@dataclass
class Shares:
    """Where the time of the slots and of the learner went, in seconds; for the progress display."""

    flow: float = 0.0
    policy: float = 0.0
    transport: float = 0.0
    waiting: float = 0.0
    learner: float = 0.0


class Watch:
    """Writes down what a training does: rows of the tables, versions, checkpoints, milestones."""

    def __init__(self, run: Run, settings: Settings, collector: Collector, progress: Progress):
        self.run, self.settings, self.collector, self.progress = run, settings, collector, progress
        self.started = time.perf_counter() - progress.wall_s
        self.simulation = collector.simulation
        self.shares = Shares()
        self.failures = len(runs.rows(run.folder / "failures.csv"))
        self._since = time.perf_counter()
        self._learning_since = self._since
        self.cd_uncontrolled = (
            self.simulation.baseline.shedding.cd_mean if isinstance(self.simulation, JetFlows) else None
        )

    def failed(self, failure: Failure) -> None:
        """Write down a block that was lost."""
        self.failures += 1
        row = {"wall_s": round(time.perf_counter() - self.started, 3), **asdict(failure)}
        runs.append(self.run.folder / "failures.csv", [row | {"episodes": " ".join(map(str, failure.episodes))}])

    def collected(self, model: EpisodicPPO, episodes: list[Episode]) -> None:
        """Keep the best policy: the one that played these episodes, before the update made of them."""
        self._learning_since = time.perf_counter()
        score = float(np.mean([episode.rewards.sum() for episode in episodes]))
        if score > self.progress.best:
            self.progress.best, self.progress.best_version = score, model.version
            runs.save(model, self.progress, self.run.checkpoints / "best.zip")

    def converged(self, model: EpisodicPPO) -> bool:
        """Return whether the last `patience` updates brought no better episodes."""
        patience = model.learning.patience
        return patience is not None and model.version - 1 - self.progress.best_version >= patience

    def updated(self, model: EpisodicPPO, episodes: list[Episode]) -> None:
        """Write the rows of an update and its episodes, then the checkpoint."""
        now, update = time.perf_counter(), model.version - 1
        collecting, learning = self._learning_since - self._since, now - self._learning_since
        wall = self._learning_since - self.started
        self._count(episodes, collecting, learning)
        clock = self._clock(episodes, wall)
        rows = [
            self._row(episode, update, learning / len(episodes), wall, clock[episode.index]) for episode in episodes
        ]
        runs.append(self.run.folder / "episodes.csv", rows)
        self.progress.burst = self.progress.burst + 1 if self._at_once(update, collecting) else 0
        staleness = [row["staleness"] for row in rows]
        logged = model.logger.name_to_value
        runs.append(
            self.run.folder / "updates.csv",
            [
                {
                    "update": update,
                    "episodes": (update + 1) * len(episodes),
                    "learning_rate": float(logged.get("train/learning_rate", np.nan)),
                    "staleness_mean": float(np.mean(staleness)),
                    "staleness_max": max(int(update - episode.versions[0]) for episode in episodes),
                    "clipped_before": model.clipped_before,
                    "clip_fraction": float(logged.get("train/clip_fraction", np.nan)),
                    "approx_kl": float(logged.get("train/approx_kl", np.nan)),
                    "burst": self.progress.burst,
                    "collect_s": round(collecting, 3),
                    "learner_s": round(learning, 3),
                    "wall_s": round(now - self.started, 3),
                    "clock_s": round(max(clock.values()), 3),
                }
            ],
        )
        whole = [row["c_d_second_half"] for row in rows if not row["terminated"] and "c_d_second_half" in row]
        if whole and self.cd_uncontrolled is not None:
            for share, when in self.progress.reached.items():
                if when is None and 1 - np.mean(whole) / self.cd_uncontrolled >= float(share):
                    self.progress.reached[share] = ((update + 1) * len(episodes), wall)
        self.checkpoint(model)
        self._since = time.perf_counter()

    def _row(self, episode: Episode, update: int, learner: float, wall: float, clock: float) -> dict[str, Any]:
        return {
            "episode": episode.index,
            "version": episode.versions[0],
            "update": update,
            "staleness": round(float(np.mean(update - episode.versions)), 3),
            **_played(self.simulation, episode),
            "flow_s": round(episode.flow_seconds, 4),
            "policy_s": round(episode.policy_seconds, 4),
            "transport_s": round(episode.transport_seconds, 4),
            "waiting_s": round(episode.waiting_seconds, 4),
            "learner_s": round(learner, 4),
            "wall_s": round(wall, 3),
            "clock_s": round(clock, 3),
        }

    def _clock(self, episodes: list[Episode], wall: float) -> dict[int, float]:
        """Return when each episode came, by the run's clock."""
        plan = self.collector.plan
        if plan is not None and self.settings.collection.clock == "virtual":
            return {episode.index: float(plan.time[episode.index]) for episode in episodes}
        return {episode.index: wall - episode.waiting_seconds for episode in episodes}

    def _at_once(self, update: int, collecting: float) -> bool:
        """Return whether an update's episodes had all come before the one before it was done."""
        plan = self.collector.plan
        if plan is None:
            return update > 0 and collecting < 0.01
        return update > 0 and bool(plan.time[plan.update == update].max() <= plan.ready[update - 1])

    def _count(self, episodes: list[Episode], collecting: float, learning: float) -> None:
        shares = self.shares
        flow = sum(episode.flow_seconds for episode in episodes)
        policy = sum(episode.policy_seconds for episode in episodes)
        transport = sum(episode.transport_seconds for episode in episodes)
        shares.flow, shares.policy = shares.flow + flow, shares.policy + policy
        shares.transport += transport
        slots = min(self.collector.engine.slots, self.collector.layout.workers)
        shares.waiting += max(slots * collecting - flow - policy - transport, 0.0)
        shares.learner += learning

    def checkpoint(self, model: EpisodicPPO) -> None:
        """Write down where the training stands: after a whole number of updates."""
        self.progress.version, self.progress.pending = model.version, self.collector.pending()
        self.progress.wall_s = time.perf_counter() - self.started
        runs.checkpoint(self.run, model, self.progress)


def _played(simulation: Simulation, episode: Episode) -> dict[str, float]:
    """Return what an episode's row has of the episode itself: all but who used it when, and the times."""
    return {
        "length": len(episode.rewards),
        "reward": float(episode.rewards.sum()),
        "terminated": int(episode.terminated),
        **simulation.summary(episode),
    }


def plan(settings: Settings, layout: collect.Layout, horizon: int) -> Plan | None:
    """Return which episode is played by which version; None when only the machine's clock can tell."""
    how, learning = settings.collection, settings.learning
    if how.schedule == "unsynced" and how.clock == "real":
        return None
    seconds = schedule.durations(settings.seed, learning.episodes, how.episode_seconds, how.episode_spread)
    model = (seconds, layout.environments, learning.update_period, how.update_seconds)
    if how.schedule == "synced":
        return schedule.synced(*model)
    return schedule.unsynced(*model, horizon if how.newest_policy == "action" else 1)


def train(
    folder: Path,
    settings: Settings,
    engine: Engine,
    layout: collect.Layout,
    show: Show = lambda episodes, shares, failures: None,
) -> Trained:
    """Train into a new run folder; ValueError when it already holds a run or cannot be written.

    show: called with each block of episodes that comes, where the time went so far, and how many blocks were lost.
    """
    run = Run(folder)
    with runs.held(folder):
        if (folder / "settings.json").exists():
            raise ValueError(
                f"run: {folder} already holds a training; choose another --run, delete it, "
                f"or go on with: manywake resume {folder}"
            )
        described = {
            **asdict(settings),
            "layout": asdict(layout),
            "versions": {name: version(name) for name in ("manywake", "numba", "numpy", "stable-baselines3", "torch")},
            "python": platform.python_version(),
        }
        simulation: Simulation
        if settings.env is None:
            ops, base = baseline.assembled(settings.case)
            simulation = JetFlows(ops, base, settings.task)
            described |= {"baseline": base.digest(), "operators": ops.digest}
        else:
            simulation = external.open_simulation(settings.env, settings.task.actions_per_episode, settings.env_folder)
        collector = _collector(settings, simulation, engine, layout)
        model = ppo.build(settings.learning, collector)
        _check_space(folder, model)
        if isinstance(simulation, JetFlows):
            baseline.save(simulation.baseline, folder / "baseline.npz")
            operators.save(simulation.operators, folder / "operators.npz")
        watch = Watch(run, settings, collector, Progress())
        watch.checkpoint(model)
        runs.write_json(folder / "settings.json", described)
        return _learn(watch, model, show)


def resume(
    folder: Path,
    engine: Engine,
    layout: collect.Layout,
    show: Show = lambda episodes, shares, failures: None,
    time_limit: float | None = None,
) -> Trained:
    """Go on from the newest checkpoint that is whole, to the same bits as a training that was never stopped.

    time_limit: seconds a block may take, in place of the run's own setting.
    """
    run = Run(folder)
    settings = run.settings
    if time_limit is not None:
        settings = replace(settings, collection=replace(settings.collection, time_limit=time_limit))
    with runs.held(folder):
        collector = _collector(settings, run.simulation(), engine, layout)
        model = ppo.build(settings.learning, collector)
        progress = runs.restore(run, model)
        for name in ("episodes.csv", "updates.csv"):
            runs.cut(folder / name, progress.version)
        runs.cut(folder / "failures.csv", None)
        collector.resume(progress.version, progress.pending, run.version)
        return _learn(Watch(run, settings, collector, progress), model, show)


def _collector(settings: Settings, simulation: Simulation, engine: Engine, layout: collect.Layout) -> Collector:
    if settings.collection.schedule == "synced" and layout.environments > settings.learning.update_period:
        raise ValueError(
            f"envs: got {layout.environments}, wanted at most the {settings.learning.update_period} episodes that a "
            "synced update waits for; use --schedule unsynced, or a longer --update-period"
        )
    limit = settings.collection.time_limit
    return Collector(
        engine,
        simulation,
        settings.seed,
        layout,
        settings.learning.update_period,
        settings.learning.episodes,
        plan(settings, layout, simulation.horizon),
        limit,
        simulation.expected_seconds(layout.lanes) if limit is None and not isinstance(engine, Threads) else None,
    )


def _learn(watch: Watch, model: EpisodicPPO, show) -> Trained:
    collector, folder = watch.collector, watch.run.folder
    collector.seen = lambda episodes: show(episodes, watch.shares, watch.failures)
    collector.failed = watch.failed
    model.hooks = ppo.Hooks(watch.collected, watch.updated, watch.converged)
    model.set_logger(configure(str(folder / "tensorboard"), ["tensorboard"]))
    learning = model.learning
    left = (learning.episodes - model.version * learning.update_period) * collector.simulation.horizon
    try:
        if left:
            model.learn(left, reset_num_timesteps=False)
    except EpisodeFailed as error:
        raise RuntimeError(
            f"{error}; play it alone with: manywake replay {folder} {error.index}; "
            f"then go on with: manywake resume {folder}"
        ) from error
    except OSError as error:
        raise RuntimeError(
            f"run: cannot write {error.filename or folder} ({error}); make room, then go on with: "
            f"manywake resume {folder}"
        ) from error
    finally:
        model.logger.close()
    episodes = model.version * learning.update_period
    return Trained(watch.progress.wall_s, episodes, ppo.digest(model), watch.progress.reached, watch.failures)


@dataclass(frozen=True)
class Replay:
    """An episode played again.

    recorded: its row in episodes.csv, None when it never got there. same: whether all its numbers but the times agree
    to the bit; None without a row.
    """

    episode: Episode
    numbers: dict[str, float]
    recorded: dict[str, str] | None
    same: bool | None


def replay(run: Run, index: int) -> Replay:
    """Play one episode of a run again, alone and in this process, with the policies it was played by."""
    settings, simulation = run.settings, run.simulation()
    rows = {int(row["episode"]): row for row in runs.rows(run.folder / "episodes.csv")}
    recorded = rows.get(index)
    asks = _played_by(run, settings, index, recorded, simulation.horizon)
    versions, which = np.unique(asks, return_inverse=True)
    exploration = explore(settings.seed, index, simulation.horizon, simulation.spaces()[1].shape[0], which)
    episode = simulation.play([run.version(int(version)) for version in versions], [exploration])[0]
    numbers = _played(simulation, episode)
    same = (
        all(recorded[name] == str(value) for name, value in numbers.items() if name in recorded) if recorded else None
    )
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
    for row in reversed(runs.rows(run.folder / "failures.csv")):
        if str(index) in row["episodes"].split():
            return np.array([int(row["version"])])
    raise ValueError(f"episode: got {index}, which was not begun; wanted one of episodes.csv or failures.csv")


def _check_space(folder: Path, model: EpisodicPPO) -> None:
    """Raise ValueError when the disk cannot hold what the run will write."""
    weights = sum(4 * parameter.numel() for parameter in model.policy.parameters())
    versions = model.learning.episodes // model.learning.update_period + 1
    wanted = 4 * 3 * weights + versions * weights // 2 + 30e6  # checkpoints with Adam's moments, versions, the rest
    free = shutil.disk_usage(folder).free
    if free < wanted:
        raise ValueError(
            f"run: {folder} has {free / 1e6:.0f} MB of free space, wanted {wanted / 1e6:.0f} MB; "
            "make room or choose another --run"
        )
