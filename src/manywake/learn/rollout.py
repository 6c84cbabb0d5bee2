"""Episodes: what the learner asks for. An episode is a function of its arguments only."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import ArrayLike

from manywake.learn.engine import Engine
from manywake.learn.policy import Policy


@dataclass(frozen=True)
class Episode:
    """One finished episode of T actions.

    observations: (T, values) before each action, last_observation: (values,) after the last. actions: (T, actions) as
    drawn, before clipping, with their log_probs (T,). rewards: (T,). readings: named scalars of each action, (T,).
    terminated: it ended at a state without value (a flow that blew up), not at the horizon. versions: (T,) of the
    policies that drew the actions. flow_seconds, policy_seconds: its share of its block's time. transport_seconds: of
    the rest of the way to the learner. waiting_seconds: how long it then lay there until an update used it.
    """

    index: int
    versions: np.ndarray
    observations: np.ndarray
    last_observation: np.ndarray
    actions: np.ndarray
    log_probs: np.ndarray
    rewards: np.ndarray
    readings: dict[str, np.ndarray]
    terminated: bool
    flow_seconds: float
    policy_seconds: float
    transport_seconds: float = 0.0
    waiting_seconds: float = 0.0


@dataclass(frozen=True)
class Context:
    """What is one episode's own. seed: of the simulation. noise: (horizon, actions). which: policy of each action.

    The noise is drawn where the learner is, not where the episode is played: the normal distribution's tail asks the
    machine's mathematical library for logarithms, and two machines need not agree on the last bit.
    """

    index: int
    seed: int
    noise: np.ndarray
    which: np.ndarray


def seed(run_seed: int, index: int) -> int:
    """Return the seed of an episode's simulation: it names the episode, not the process that plays it."""
    return int(np.random.SeedSequence(run_seed, spawn_key=(index,)).generate_state(1)[0])


def context(run_seed: int, index: int, horizon: int, actions: int, asks: ArrayLike = (0,)) -> Context:
    """Return the context of one episode. asks: which policy draws the actions of each of equal parts of the horizon."""
    sequence, asks = np.random.SeedSequence(run_seed, spawn_key=(index,)), np.asarray(asks)
    noise = np.random.default_rng(sequence).standard_normal((horizon, actions))
    which = asks[np.arange(horizon) * len(asks) // horizon].astype(np.int16)
    return Context(index, seed(run_seed, index), noise, which)


class Evaluated(Protocol):
    """What an evaluation found: numbers as JSON can hold them, rows to be shown (heads first), pictures, if any."""

    def summary(self) -> dict[str, Any]: ...

    def table(self) -> list[tuple[str, ...]]: ...

    def draw(self, folder: Path, tail: str) -> None:
        return


class Simulation(Protocol):
    """What can be played: a description that travels to the workers once. Nothing of `learn` knows which it is.

    horizon: most actions of an episode.
    """

    horizon: int

    def spaces(self) -> tuple[Box, Box]:
        """Return the observation and the action space."""

    def variant(self, seed: int) -> int:
        """Return which of its variants, its Reynolds numbers say, an episode's seed draws; a block has one only."""
        return 0

    def play(self, driving: Sequence[Policy], contexts: list[Context]) -> list[Episode]:
        """Play episodes of one variant side by side and return them in the order asked for."""

    def summary(self, episode: Episode) -> dict[str, float]:
        """Return an episode's numbers, for tables and the progress bar."""

    def gain(self, summary: dict[str, float]) -> float:
        """Return what an episode saved, as a share of what there was without control; NaN where there is no such."""
        return math.nan

    def expected_seconds(self, lanes: int) -> float | None:
        """Return about how long a block of `lanes` episodes takes, compiling excluded; None if that is not known."""
        return None

    def evaluate(self, policy: Policy, engine: Engine) -> Evaluated:
        """Return what the deterministic policy achieves."""

    def describe(self) -> dict[str, Any]:
        """Return what it is, as JSON can hold it; `kind` says who can open it again."""

    def save(self, folder: Path) -> dict[str, Any]:
        """Keep in a run's folder what playing on needs; return its hashes."""
        return {}


def play(simulation: Simulation, contexts: list[Context], *driving: Policy) -> list[Episode]:
    """Play a block in a worker."""
    return simulation.play(driving, contexts)
