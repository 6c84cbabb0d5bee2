"""Controlled against uncontrolled: a controller, for one episode, for the long run, from starts it was not made for."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from manywake.case.case import Case
from manywake.case.task import Task
from manywake.env.control import ControlledFlows, drive
from manywake.flow import baseline, spinup
from manywake.flow.baseline import Baseline
from manywake.flow.batch import FlowBatch, Start
from manywake.flow.readings import KINDS
from manywake.flow.statistics import half_width
from manywake.flow.store import Flow
from manywake.learn import tables
from manywake.learn.controllers import Controller
from manywake.learn.engine import Engine
from manywake.machine import disk

LONG_RUN = 4
"""Episode lengths of the long run, without reset."""
PHASES = 8
"""Starts of the long run: phases of shedding, or states that flows come to which do not shed regularly."""
TABLED = {
    "cd_uncontrolled": ("C_D uncontrolled", ".4f"),
    "cd_controlled": ("C_D controlled", ".4f"),
    "drag_reduction": ("drag reduction", ".2%"),
    "net_reduction": ("drag reduction less the power", ".2%"),
    "share_of_shedding_drag": ("share of the shedding drag removed", ".1%"),
    "cl_mean": ("C_L mean", "+.3f"),
    "cl_rms": ("C_L rms, about zero", ".3f"),
    "cl_std": ("C_L rms, about its mean", ".3f"),
    "amplitude_rms": ("amplitude rms / limit", ".1%"),
    "power": ("power C_P of the inputs", ".4f"),
    "reward": ("reward of an action", ".4f"),
}
"""What tables show of `Control`, with a label and a format each."""


@dataclass(frozen=True)
class Control:
    """What a controller achieves over a window. C = 2F / (rho U^2 L), C_P = 2P / (rho U^3 L).

    cd_uncontrolled: mean over whole periods of the same mesh and time step. cd_steady: of the steady base flow.
    drag_reduction: saved / cd_uncontrolled, with saved = cd_uncontrolled - cd_controlled. net_reduction: (saved -
    power) / cd_uncontrolled. share_of_shedding_drag: saved / (cd_uncontrolled - cd_steady). cl_rms, amplitude_rms:
    about zero, the latter over all inputs in units of their limits. cl_std: about its mean. power: mean C_P of the
    inputs. reward: mean of an action's. diverged: the flow blew up; the numbers mean nothing. measured: means of the
    sensors that are integrals, by name.
    """

    cd_uncontrolled: float
    cd_controlled: float
    cd_steady: float
    drag_reduction: float
    net_reduction: float
    share_of_shedding_drag: float
    cl_mean: float
    cl_rms: float
    cl_std: float
    amplitude_rms: float
    power: float
    reward: float
    diverged: bool
    measured: dict[str, float]


@dataclass(frozen=True)
class Trajectory:
    """Every solver step of B flows: series of readings by name (steps, B), amplitudes (steps, actuators, B).

    rewards: (actions, B). ends: the final states.
    """

    series: dict[str, np.ndarray]
    amplitudes: np.ndarray
    rewards: np.ndarray
    ends: list[Start]


@dataclass(frozen=True)
class Evaluation:
    """episode: second half of one episode from the start state. long_run: second half of four episode lengths.

    phases: the long run from eight phases of shedding, the start state first. trajectory: of all of them.
    """

    flow: Flow
    episode: Control
    long_run: Control
    phases: list[Control]
    trajectory: Trajectory

    def summary(self) -> dict[str, Any]:
        phases = [_plain(control) for control in self.phases]
        over = {name: dict(zip(("mean", "error"), self.over_starts(name), strict=True)) for name in TABLED}
        over = {name: part for name, part in over.items() if np.isfinite(part["mean"])}
        return {**_plain(self.episode), "long_run": _plain(self.long_run), "phases": phases, "over_starts": over}

    def over_starts(self, name: str) -> tuple[float, float]:
        """Return the mean over the starts and half the width of its 95 % confidence interval, of a number."""
        numbers = np.array([getattr(control, name) for control in self.phases])
        return float(numbers.mean()), half_width(numbers)

    def table(self) -> list[tuple[str, ...]]:
        worst = min(self.phases, key=lambda control: -np.inf if control.diverged else control.reward)
        heads = "second halves, without noise", "one episode", "long run", f"its mean over {PHASES} starts", "worst"
        rows: list[tuple[str, ...]] = [heads]
        for name, (label, style) in TABLED.items():
            if np.isnan(getattr(self.episode, name)) and not self.episode.diverged:
                continue  # what a flow without bodies has not
            windows = [
                "blew up" if window.diverged else format(getattr(window, name), style)
                for window in (self.episode, self.long_run, worst)
            ]
            mean, error = self.over_starts(name)
            rows.append((label, *windows[:2], f"{mean:{style}} ± {error:{style.lstrip('+')}}", windows[2]))
        for name in self.episode.measured:
            numbers = [control.measured[name] for control in (self.episode, self.long_run, worst)]
            over = float(np.mean([control.measured[name] for control in self.phases]))
            shown = [f"{number:.4g}" for number in (*numbers[:2], over, numbers[2])]
            rows.append((f"{name}; uncontrolled {self.flow.baseline.free[name]:.4g}", *shown))
        return rows

    def draw(self, folder: Path, tail: str) -> None:
        """Draw the wake, and the learning curve where the folder has a table of episodes; write the wake's series."""
        self.draw_as(folder, tail, _episodes(folder))

    def draw_as(self, folder: Path, tail: str, episodes: dict[str, np.ndarray]) -> None:
        """Draw the learning curve of episodes, where there are any, and the wake; tail: of the files' names."""
        from manywake import plots

        whole, base = self.trajectory, self.flow.baseline
        title = ", ".join(filter(None, (titled(folder), f"Re {self.flow.case.reynolds:g}")))
        if episodes:
            plots.learning_curve(episodes, base, title, folder / f"learning-curve{tail}.png")
        free = FlowBatch(self.flow.operators, base.start, 1)
        uncontrolled = spinup.free_run(free, len(whole.amplitudes))
        table = record(self.flow.case, base.shown, whole, uncontrolled)
        _write(table, folder / f"wake{tail}.csv")
        plots.wake(self.flow, free.state(0), whole.ends[0], table, title, folder / f"wake{tail}.png")


def titled(folder: Path) -> str:
    """Return what pictures say of the run in a folder: what was trained on, for which reward, its seed; or nothing."""
    path = folder / "settings.json"
    if not path.exists():
        return ""
    described = json.loads(path.read_text())
    simulation, words = described["simulation"], []
    if "task" in simulation:
        reward = simulation["task"]["reward"]["name"]
        words.append("a reward of its own" if reward == "reward" else f"reward {reward}")
    name = simulation.get("name") or simulation.get("env") or simulation["kind"]
    return ", ".join((name, *words, f"seed {described['seed']}"))


def record(
    case: Case, names: Sequence[str], whole: Trajectory, uncontrolled: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Return the columns of wake.csv, a row a solver step: readings with and without control, what drives the flow.

    names: of the readings. whole: its first flow is taken. uncontrolled: series (steps, 1) by name.
    """
    time = (np.arange(len(whole.amplitudes)) + 1) * case.dt / case.convective_time
    controlled = {name: whole.series[name][:, 0] for name in names}
    free = {f"{name}_uncontrolled": uncontrolled[name][:, 0] for name in names}
    driven = {f"amplitude.{a.on}": whole.amplitudes[:, k, 0] for k, a in enumerate(case.actuators)}
    return {"time": time} | controlled | free | driven


def _write(table: dict[str, np.ndarray], path: Path) -> None:
    """Write columns as CSV with seven digits, whole or not at all."""
    rows, style = np.column_stack(list(table.values())), {"fmt": "%.7g", "delimiter": ",", "comments": ""}
    disk.write(path, lambda file: np.savetxt(file, rows, header=",".join(table), **style))


@dataclass(frozen=True)
class Evaluations:
    """Evaluations of one controller at several Reynolds numbers."""

    parts: list[Evaluation]

    def summary(self) -> dict[str, Any]:
        return {"at": {f"{part.flow.case.reynolds:g}": part.summary() for part in self.parts}}

    def table(self) -> list[tuple[str, ...]]:
        shown = [name for name in TABLED if name not in ("net_reduction", "share_of_shedding_drag", "cl_rms", "cl_std")]
        rows: list[tuple[str, ...]] = [("long run: Re", *(TABLED[name][0] for name in shown))]
        for part in self.parts:
            now = part.long_run
            numbers = [format(getattr(now, name), TABLED[name][1]) for name in shown]
            rows.append((f"{part.flow.case.reynolds:g}", *(["blew up"] * len(shown) if now.diverged else numbers)))
        return rows

    def draw(self, folder: Path, tail: str) -> None:
        """Draw learning curve and wake at each Reynolds number, and write the wake's series."""
        episodes = _episodes(folder)
        for part in self.parts:
            reynolds = part.flow.case.reynolds
            mine = episodes["reynolds"] == reynolds if episodes else np.zeros(0, dtype=bool)
            part.draw_as(
                folder, f"{tail}-{reynolds:g}", {n: x[mine] for n, x in episodes.items()} if mine.any() else {}
            )


def _episodes(folder: Path) -> dict[str, np.ndarray]:
    """Return the table of a run's episodes, empty where there is none."""
    return tables.columns(folder / "episodes.csv")


def _plain(control: Control) -> dict[str, Any]:
    """Return the fields with None for what is not a number, as JSON wants it."""
    numbers = asdict(control)
    measured = numbers.pop("measured")
    return {key: value if np.isfinite(value) else None for key, value in (numbers | measured).items()}


def play(
    flow: Flow, task: Task, controller: Controller, starts: list[Start], actions: int, first: int = 0
) -> Trajectory:
    """Run a controller from each start for a number of actions, without reset.

    first: seed of the first start's episode; those of the others follow.
    """
    flows = ControlledFlows(flow, task, len(starts))
    for column, start in enumerate(starts):
        flows.reset([column], [first + column], start)
    outcomes = [step.outcome for step in drive(flows, controller.on(flows), actions)]
    return Trajectory(
        {name: np.concatenate([outcome.series[name] for outcome in outcomes]) for name in outcomes[0].series},
        np.concatenate([outcome.amplitudes for outcome in outcomes]),
        np.stack([outcome.reward for outcome in outcomes]),
        [flows.batch.state(column) for column in range(len(starts))],
    )


def _play(simulation: Any, k: int, controller: Controller, starts: list[Start], actions: int, first: int) -> Trajectory:
    """Play the k-th flow in a worker; simulation: `flows.Flows`, as it was shared."""
    return play(simulation.flows[k], simulation.task, controller, starts, actions, first)


def control(base: Baseline, limits: np.ndarray, part: Trajectory, column: int) -> Control:
    """Return the statistics of one flow over a window; limits: (inputs,)."""
    missing = np.full(len(part.amplitudes), np.nan)
    c_d, c_l, power = (part.series[n][:, column] if n in part.series else missing for n in ("c_d", "c_l", "power"))
    cd0, steady, cd = base.free.get("c_d", np.nan), base.steady.get("c_d", np.nan), float(np.mean(c_d))
    saved, rms = cd0 - cd, lambda series: float(np.sqrt(np.mean(series**2)))
    return Control(
        cd_uncontrolled=cd0,
        cd_controlled=cd,
        cd_steady=steady,
        drag_reduction=saved / cd0,
        net_reduction=(saved - float(np.mean(power))) / cd0,
        share_of_shedding_drag=saved / (cd0 - steady),
        cl_mean=float(np.mean(c_l)),
        cl_rms=rms(c_l),
        cl_std=float(np.std(c_l)),
        amplitude_rms=rms(part.amplitudes[:, :, column] / limits),
        power=float(np.mean(power)),
        reward=float(np.mean(part.rewards[:, column])),
        diverged=not np.isfinite(power).all(),
        measured={
            name: float(np.mean(part.series[name][:, column]))
            for name in base.free
            if name in part.series and name.partition(".")[0] not in (*KINDS, "power")
        },
    )


def window(whole: Trajectory, first: int, last: int) -> Trajectory:
    """Return the part of a trajectory between two solver steps, and the rewards of the actions within."""
    steps = len(whole.amplitudes) // len(whole.rewards)
    series = {name: part[first:last] for name, part in whole.series.items()}
    rewards = whole.rewards[first // steps : -(-last // steps)]
    return Trajectory(series, whole.amplitudes[first:last], rewards, whole.ends)


def evaluate(shared: Any, k: int, flow: Flow, task: Task, controller: Controller, engine: Engine) -> Evaluation:
    """Evaluate a controller: `PHASES` long runs side by side, spread over the engine's slots.

    shared: what stands for the simulation in the engine's calls, of which this flow is the k-th.
    """
    base, actions, share = flow.baseline, LONG_RUN * task.actions, -(-PHASES // engine.slots)
    starts = baseline.phases(flow.operators, base, PHASES, flow.case.convective_time)
    spread = [(starts[k : k + share], k) for k in range(0, PHASES, share)]
    futures = [engine.submit(_play, shared, k, controller, some, actions, first) for some, first in spread]
    parts = [future.result() for future in futures]
    trajectory = Trajectory(
        {name: np.concatenate([part.series[name] for part in parts], axis=1) for name in parts[0].series},
        np.concatenate([part.amplitudes for part in parts], axis=2),
        np.concatenate([part.rewards for part in parts], axis=1),
        [end for part in parts for end in part.ends],
    )
    steps, total = task.actions * task.steps(flow.case.dt), len(trajectory.amplitudes)
    limits = np.array([actuator.limit for actuator in flow.case.actuators])
    late = window(trajectory, total // 2, total)
    phases = [control(base, limits, late, column) for column in range(PHASES)]
    episode = control(base, limits, window(trajectory, steps // 2, steps), 0)
    return Evaluation(flow, episode, phases[0], phases, trajectory)
