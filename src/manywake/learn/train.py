"""Training into a run folder, and going on with one."""

import shutil
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from stable_baselines3.common.logger import configure

from manywake.learn import checkpoints, ppo, rollout, rows, runs, schedule, tables
from manywake.learn.blocks import AsTheyCome, Layout, Order, Planned
from manywake.learn.checkpoints import Progress
from manywake.learn.collect import Collector, EpisodeFailed, Failure
from manywake.learn.engine import Engine
from manywake.learn.ppo import EpisodicPPO
from manywake.learn.rollout import Episode, Simulation
from manywake.learn.rows import Clocks, Shares
from manywake.learn.runs import Run
from manywake.learn.schedule import Plan
from manywake.learn.settings import Settings

Show = Callable[[list[Episode], Shares, int], None]
"""show(episodes, shares, failures): called with each block that comes, where the time went, blocks lost so far."""


def quiet(episodes: list[Episode], shares: Shares, failures: int) -> None:
    """Show nothing."""


@dataclass(frozen=True)
class Trained:
    """What a training leaves. failures: blocks that were lost and played again."""

    wall_time_s: float
    episodes: int
    policy_sha256: str
    failures: int


class Training:
    """A training under way: writes down, in one order, what an update brought."""

    def __init__(self, run: Run, settings: Settings, collector: Collector, plan: Plan | None, progress: Progress):
        self.run, self.settings, self.collector, self.plan, self.progress = run, settings, collector, plan, progress
        self.started = time.perf_counter() - progress.wall_s
        self.shares = Shares()
        self.failures = len(tables.read(run.folder / "failures.csv"))
        self._since = self._learning_since = time.perf_counter()

    def failed(self, failure: Failure) -> None:
        self.failures += 1
        wall, episodes = round(time.perf_counter() - self.started, 3), " ".join(map(str, failure.episodes))
        tables.append(self.run.folder / "failures.csv", [{"wall_s": wall, **asdict(failure), "episodes": episodes}])

    def collected(self, model: EpisodicPPO, episodes: list[Episode]) -> None:
        """Keep the best policy: the one that played these episodes, before the update made of them."""
        self._learning_since = time.perf_counter()
        score = float(np.mean([episode.rewards.sum() for episode in episodes]))
        if score > self.progress.best:
            self.progress.best, self.progress.best_version = score, model.version
            checkpoints.save(model, self.progress, self.run, "best")

    def converged(self, model: EpisodicPPO) -> bool:
        patience = model.learning.patience
        return patience is not None and model.version - 1 - self.progress.best_version >= patience

    def updated(self, model: EpisodicPPO, episodes: list[Episode]) -> None:
        """Write the rows of an update and its episodes, then the checkpoint, which is what a resume goes by."""
        now, number, between = time.perf_counter(), model.version - 1, self._learning_since
        clocks = Clocks(between - self._since, now - between, between - self.started, now - self.started)
        self.shares.count(episodes, min(self.collector.engine.slots, self.collector.grid.workers), clocks)
        virtual = self.settings.collection.clock == "virtual"
        clock = rows.came(episodes, clocks.collected, self.plan if virtual else None)
        learner, simulation = clocks.learning / len(episodes), self.collector.simulation
        table = [rows.episode(simulation, one, number, learner, clocks, clock[one.index]) for one in episodes]
        tables.append(self.run.folder / "episodes.csv", table)
        at_once = rows.at_once(number, clocks.collecting, self.plan)
        self.progress.burst = self.progress.burst + 1 if at_once else 0
        logged = {**model.logger.name_to_value, "train/clipped_before": model.clipped_before}
        row = rows.update(number, episodes, logged, self.progress.burst, clocks, max(clock.values()))
        tables.append(self.run.folder / "updates.csv", [row])
        self.checkpoint(model)
        self._since = time.perf_counter()

    def checkpoint(self, model: EpisodicPPO) -> None:
        self.progress.version, self.progress.pending = model.version, self.collector.pending()
        self.progress.wall_s = time.perf_counter() - self.started
        checkpoints.checkpoint(self.run, model, self.progress)


def plan(settings: Settings, grid: Layout, horizon: int) -> Plan | None:
    """Return which episode is played by which version; None when only the machine's clock can tell."""
    how, learning = settings.collection, settings.learning
    if how.schedule == "unsynced" and how.clock == "real":
        return None
    seconds = schedule.durations(settings.seed, learning.episodes, how.episode_seconds, how.episode_spread)
    model = (seconds, grid.environments, learning.update_period, how.update_seconds)
    if how.schedule == "synced":
        return schedule.synced(*model)
    return schedule.unsynced(*model, horizon if how.newest_policy == "action" else 1)


def train(
    folder: Path, simulation: Simulation, settings: Settings, engine: Engine, grid: Layout, show: Show = quiet
) -> Trained:
    """Train into a new run folder; ValueError when it already holds a run or cannot be written."""
    run, planned = Run(folder), plan(settings, grid, simulation.horizon)
    collector = _collector(settings, simulation, engine, grid, planned)
    with runs.held(folder):
        if (folder / "settings.json").exists():
            remedy = f"choose another --run, delete it, or go on with: manywake resume {folder}"
            raise ValueError(f"run: {folder} already holds a training; {remedy}")
        model = ppo.build(settings.learning, collector)
        _check_space(folder, model)
        kept = simulation.save(folder)
        training = Training(run, settings, collector, planned, Progress())
        training.checkpoint(model)
        described = {"format": runs.FORMAT, "simulation": simulation.describe(), **asdict(settings)}
        made = {"layout": asdict(grid), "kept": kept, "versions": runs.versions()}
        runs.write_json(folder / "settings.json", described | made)
        return _learn(training, model, show)


def resume(
    folder: Path,
    simulation: Simulation,
    engine: Engine,
    grid: Layout,
    show: Show = quiet,
    time_limit: float | None = None,
) -> Trained:
    """Go on from the newest checkpoint that is whole, to the same bits as a training that was never stopped.

    simulation: what the run played, opened again. time_limit: seconds a block may take, in place of the run's own.
    """
    run, settings = Run(folder), Run(folder).settings
    if time_limit is not None:
        settings = replace(settings, collection=replace(settings.collection, time_limit=time_limit))
    with runs.held(folder):
        planned = plan(settings, grid, simulation.horizon)
        collector = _collector(settings, simulation, engine, grid, planned)
        model = ppo.build(settings.learning, collector)
        name, progress = checkpoints.restore(run, model)
        rows = {"episodes.csv": settings.learning.update_period, "updates.csv": 1}
        for table, count in rows.items():
            tables.check(folder / table, progress.version, count)
        if name == "previous":  # a damaged last would be put in the place of the whole one by the next checkpoint
            (run.checkpoints / "last.zip").unlink(missing_ok=True)
        for table in rows:
            tables.cut(folder / table, progress.version)
        tables.cut(folder / "failures.csv")
        runs.went_on(run, progress.version)
        collector.resume(progress.version, progress.pending, run.version)
        return _learn(Training(run, settings, collector, planned, progress), model, show)


def _collector(
    settings: Settings, simulation: Simulation, engine: Engine, grid: Layout, planned: Plan | None
) -> Collector:
    period, total = settings.learning.update_period, settings.learning.episodes
    if settings.collection.schedule == "synced" and grid.environments > period:
        raise ValueError(
            f"envs: got {grid.environments}, wanted at most the {period} episodes that a synced update waits for; "
            "use --schedule unsynced, or a longer --update-period"
        )

    def variant(index: int) -> int:
        return simulation.variant(rollout.seed(settings.seed, index))

    order: Order = AsTheyCome(grid, period, total, variant) if planned is None else Planned(planned, grid, variant)
    limit = settings.collection.time_limit
    expected = simulation.expected_seconds(grid.lanes) if limit is None and engine.keeps_time else None
    return Collector(engine, simulation, settings.seed, grid, order, limit, expected)


def _learn(training: Training, model: EpisodicPPO, show: Show) -> Trained:
    collector, folder = training.collector, training.run.folder
    collector.seen = lambda episodes: show(episodes, training.shares, training.failures)
    collector.failed = training.failed
    model.hooks = ppo.Hooks(training.collected, training.updated, training.converged)
    model.set_logger(configure(str(folder / "tensorboard"), ["tensorboard"]))
    learning = model.learning
    left = (learning.episodes - model.version * learning.update_period) * collector.simulation.horizon
    try:
        if left:
            model.learn(left, reset_num_timesteps=False)
    except EpisodeFailed as error:
        alone = f"play it alone with: manywake replay {folder} {error.index}"
        raise RuntimeError(f"{error}; {alone}; then go on with: manywake resume {folder}") from error
    except OSError as error:
        what = f"run: cannot write {error.filename or folder} ({error})"
        raise RuntimeError(f"{what}; make room, then go on with: manywake resume {folder}") from error
    finally:
        collector.stop()
        model.logger.close()
    episodes = model.version * learning.update_period
    return Trained(training.progress.wall_s, episodes, ppo.digest(model), training.failures)


def _check_space(folder: Path, model: EpisodicPPO) -> None:
    """Raise ValueError when the disk cannot hold what the run will write."""
    weights = sum(4 * parameter.numel() for parameter in model.policy.parameters())
    versions = model.learning.episodes // model.learning.update_period + 1
    wanted = 4 * 3 * weights + versions * weights // 2 + 30e6  # checkpoints with Adam's moments, versions, the rest
    free = shutil.disk_usage(folder).free
    if free < wanted:
        got = f"{folder} has {free / 1e6:.0f} MB of free space, wanted {wanted / 1e6:.0f} MB"
        raise ValueError(f"run: {got}; make room or choose another --run")
