"""What acts on flows: a policy, nothing, simple controllers with a few numbers, a user's own function; and a search.

A controller is told once which flows it is to act on, and then what is observed. Actions are in [-1, 1].
"""

import importlib
import math
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from manywake.case.case import Case
from manywake.case.task import matrix
from manywake.env.control import ControlledFlows, drive
from manywake.learn import policy as policies
from manywake.learn.engine import Engine
from manywake.learn.policy import Policy

Choose = Callable[[int, np.ndarray], np.ndarray]
"""choose(t, observations (B, values)) -> actions (B, actions)."""
LARGEST_ST = 0.6
"""Largest frequency that a search tries, in U / L."""


class Controller(Protocol):
    """Acts on flows."""

    def on(self, flows: ControlledFlows) -> Choose:
        """Return what chooses the actions of some flows, from the beginning of their episodes on."""


@dataclass(frozen=True)
class Learnt:
    """A policy without noise."""

    policy: Policy

    def on(self, flows: ControlledFlows) -> Choose:
        return lambda t, seen: policies.act(self.policy, seen)


@dataclass(frozen=True)
class Simple:
    """A controller of a family by its numbers: the same for all flows (numbers,), or of each its own (B, numbers)."""

    family: "Family"
    numbers: np.ndarray

    def on(self, flows: ControlledFlows) -> Choose:
        count = flows.mixing.shape[1]
        return self.family.on(np.broadcast_to(self.numbers, (flows.count, self.family.size(count))), flows)


@dataclass(frozen=True)
class Own:
    """A user's function (observation (values,), info) -> action (actions,); or a class, an object for each flow.

    info: of the last action every reading by name, absent before the first, and "time" in the case's unit.
    """

    function: Callable[..., Any]

    def on(self, flows: ControlledFlows) -> Choose:
        each = [self.function() if isinstance(self.function, type) else self.function for _ in range(flows.count)]
        shape = flows.mixing.shape[1:]

        def choose(t: int, seen: np.ndarray) -> np.ndarray:
            actions = np.empty((flows.count, *shape))
            for b, act in enumerate(each):
                info = {name: float(part[b]) for name, part in flows.means.items()} if t else {}
                actions[b] = _checked(act(seen[b], info | {"time": t * flows.task.interval}), shape)
            return actions

        return choose


def _checked(action: Any, shape: tuple[int, ...]) -> np.ndarray:
    found = np.asarray(action, dtype=float)
    if found.shape != shape or not np.isfinite(found).all():
        raise ValueError(f"controller: returned {action!r}, wanted {shape[0]} finite numbers in [-1, 1]")
    return found


@dataclass(frozen=True)
class Family:
    """Controllers that a few numbers choose among.

    about: what they do. size: how many numbers for so many actions. bounds: of each. on: see `Simple`. cubes: a search
    draws cube roots of the numbers, since small ones matter most, and tries zeros among the first.
    """

    about: str
    size: Callable[[int], int]
    bounds: Callable[[int], list[tuple[float, float]]]
    on: Callable[[np.ndarray, ControlledFlows], Choose]
    cubes: bool = False


def _none(x: np.ndarray, flows: ControlledFlows) -> Choose:
    still = np.zeros((flows.count, flows.mixing.shape[1]))
    return lambda t, seen: still


def _constant(x: np.ndarray, flows: ControlledFlows) -> Choose:
    return lambda t, seen: x


def _harmonic(x: np.ndarray, flows: ControlledFlows) -> Choose:
    n = flows.mixing.shape[1]
    amplitude, frequency, phase = x[:, :n], x[:, n : n + 1], np.pad(x[:, n + 1 :], ((0, 0), (1, 0)))
    unit = flows.task.interval / flows.flow.case.convective_time
    return lambda t, seen: amplitude * np.sin(2 * np.pi * (frequency * unit * t + phase))


def _feedback(x: np.ndarray, flows: ControlledFlows) -> Choose:
    n, signal = flows.mixing.shape[1], _signal(flows.flow.case, flows)
    moments, period = flows.flow.baseline.statistics.readings[signal], flows.flow.baseline.statistics.period
    rate = 1.0 if period is None else period / (2 * math.pi * flows.task.interval)
    middle, size = moments.mean, math.sqrt(max(moments.rms**2 - moments.mean**2, 1e-12))
    before = np.zeros(flows.count)

    def choose(t: int, seen: np.ndarray) -> np.ndarray:
        nonlocal before
        now = (flows.means[signal] - middle) / size
        change = rate * (now - before) if t > 1 else np.zeros(flows.count)
        before = now
        return np.clip(np.nan_to_num(x[:, :n] * now[:, None] + x[:, n:] * change[:, None]), -1.0, 1.0)

    return choose


def _signal(case: Case, flows: ControlledFlows) -> str:
    """Return the reading that feedback listens to: the lift, or the first there is but the power."""
    return "c_l" if case.bodies else next(name for name in flows.free if name != "power")


FAMILIES = {
    "none": Family("nothing acts", lambda n: 0, lambda n: [], _none),
    "constant": Family(
        "each action is held: n numbers", lambda n: n, lambda n: [(-1.0, 1.0)] * n, _constant, cubes=True
    ),
    "harmonic": Family(
        "sines: n amplitudes, one frequency in U / L, n - 1 phases in cycles behind the first",
        lambda n: 2 * n,
        lambda n: [(0.0, 1.0)] * n + [(0.02, LARGEST_ST)] + [(0.0, 1.0)] * (n - 1),
        _harmonic,
    ),
    "feedback": Family(
        "proportional to the lift, less its mean and by its rms, and to its rate of change: n and n gains",
        lambda n: 2 * n,
        lambda n: [(-1.5, 1.5)] * (2 * n),
        _feedback,
        cubes=True,
    ),
}
"""Simple controllers by name."""


def simple(name: str, numbers: Sequence[float], actions: int) -> Simple:
    """Return a simple controller; ValueError where its numbers are not as many as its family wants."""
    if name not in FAMILIES:
        raise ValueError(f"controller: got {name!r}, wanted {', '.join(FAMILIES)}, pretrained, or module:function")
    family = FAMILIES[name]
    if len(numbers) != family.size(actions):
        remedy = "find them with: manywake search" if family.size(actions) else "leave them out"
        raise ValueError(
            f"numbers: got {len(numbers)}, wanted {family.size(actions)} for {name} ({family.about}, n = {actions}); "
            f"{remedy}"
        )
    return Simple(family, np.array(numbers, dtype=float))


def own(name: str) -> Own:
    """Return the controller that module:function names; the working folder is looked in too."""
    module, _, attribute = name.partition(":")
    if os.getcwd() not in sys.path:
        sys.path.insert(0, os.getcwd())
    try:
        found = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(f"controller: got {name!r}, wanted module:function ({error})") from error
    if not callable(found):
        raise ValueError(f"controller: {name} is {found!r}, wanted a function (observation, info) -> action")
    return Own(found)


def shipped(path: Path | None, name: str, values: int) -> Learnt:
    """Return the policy that ships with a case; ValueError where there is none, or it was made for another task."""
    if path is None:
        raise ValueError(f"pretrained: no policy ships with {name}, wanted one; train one, and give its run")
    found = policies.read(path)
    if len(found.mean) != values:
        raise ValueError(
            f"pretrained: the policy of {name} was made for {len(found.mean)} observed values, got a task with {values}"
        )
    return Learnt(found)


@dataclass(frozen=True)
class Found:
    """What a search found: the best numbers, their mean reward of an action, and how many were tried."""

    numbers: tuple[float, ...]
    reward: float
    tried: int


def search(
    simulation: Any, name: str, engine: Engine, rounds: int, seed: int, report: Callable[[str, float], None]
) -> Found:
    """Search a family for the largest mean reward over the second half of an episode, by differential evolution.

    simulation: `flows.Flows`. A round plays a candidate for each lane, eight for a number and at least sixteen; where
    there are several Reynolds numbers each plays at all of them.
    """
    from scipy.optimize import differential_evolution

    actions = matrix(simulation.task, len(simulation.chosen.case.actuators)).shape[1]
    family, shared, done, tried = FAMILIES[name], engine.share(simulation), 0, 0
    bounds = np.array(family.bounds(actions))

    def numbers(roots: np.ndarray) -> np.ndarray:
        return roots * roots * roots if family.cubes else roots

    def scored(roots: np.ndarray) -> np.ndarray:
        nonlocal done, tried
        x = numbers(roots)
        parts = np.array_split(x.T, min(engine.slots, len(x.T)))
        futures = [[engine.submit(_rewards, shared, k, family, part) for part in parts] for k in _each(simulation)]
        rewards = sum(np.concatenate([future.result() for future in row]) for row in futures) / len(futures)
        done, tried = done + 1, tried + len(x.T)
        report(f"search, {name}", min(done / (rounds + 1), 1.0))
        return -np.nan_to_num(rewards, nan=-1e6)

    best = differential_evolution(
        scored,
        np.cbrt(bounds) if family.cubes else bounds,
        x0=np.zeros(len(bounds)) if family.cubes else None,
        maxiter=rounds,
        popsize=max(8, -(-16 // len(bounds))),
        init="sobol",
        rng=np.random.default_rng(seed),
        polish=False,
        updating="deferred",
        vectorized=True,
        tol=0.0,
    )
    report(f"search, {name}", 1.0)
    return Found(tuple(round(float(value), 4) for value in numbers(best.x)), -float(best.fun), tried)


def _each(simulation: Any) -> range:
    return range(len(simulation.flows))


def _rewards(simulation: Any, k: int, family: Family, numbers: np.ndarray) -> np.ndarray:
    """Return the mean rewards of controllers (B, numbers), a flow each; what a blow-up is charged counts whole."""
    task = simulation.task
    flows = ControlledFlows(simulation.flows[k], task, len(numbers))
    flows.reset(range(len(numbers)), [0] * len(numbers))
    chosen, half = Simple(family, numbers).on(flows), task.actions // 2
    total, going = np.zeros(len(numbers)), np.ones(len(numbers), dtype=bool)
    for t, step in enumerate(drive(flows, chosen, task.actions)):
        outcome = step.outcome
        total += np.where(going & ((t >= half) | outcome.diverged), outcome.reward, 0.0)
        going &= ~outcome.diverged
        if not going.any():
            break
    return total / (task.actions - half)
