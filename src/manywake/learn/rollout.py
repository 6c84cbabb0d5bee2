"""Episodes: what the learner asks for. An episode is a function of its arguments only."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import ArrayLike

from manywake.env.env import spaces
from manywake.env.task import ControlledFlow, Task
from manywake.flow.baseline import Baseline
from manywake.flow.operators import Operators
from manywake.learn import policy as policies
from manywake.learn.policy import Policy


@dataclass(frozen=True)
class Episode:
    """One finished episode of T actions.

    observations: (T, values) before each action, last_observation: (values,) after the last. actions: (T, actions) as
    drawn, before clipping, with their log_probs (T,). rewards: (T,). readings: named scalars of each action, (T,), of a
    cylinder c_d, c_l and jets. terminated: it ended at a terminal state (a flow that blew up), which has no value;
    otherwise the horizon was reached. versions: (T,) of the policies that drew the actions.
    flow_seconds, policy_seconds: this episode's share of its block's time; transport_seconds, waiting_seconds: its
    share of the rest of the way to the learner, and how long it then lay there until an update used it.
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
class Exploration:
    """What is one episode's own, and not the simulation's or the policies'.

    seed: for the simulation. noise: of the actions, (horizon, actions). which: of the policies the episode is played
    with, the one that draws each action, (horizon,). The noise is drawn where the learner is and not where the episode
    is played: the normal distribution's tail asks the machine's mathematical library for logarithms, and two machines
    need not agree on the last bit.
    """

    index: int
    seed: int
    noise: np.ndarray
    which: np.ndarray


def explore(run_seed: int, index: int, horizon: int, actions: int, asks: ArrayLike = (0,)) -> Exploration:
    """Return the exploration of one episode: its seed names the episode, not the process that plays it.

    asks: which policy draws the actions of each of as many equal parts of the horizon.
    """
    sequence = np.random.SeedSequence(run_seed, spawn_key=(index,))
    noise = np.random.default_rng(sequence).standard_normal((horizon, actions))
    asks = np.asarray(asks)
    which = asks[np.arange(horizon) * len(asks) // horizon].astype(np.int16)
    return Exploration(index, int(sequence.generate_state(1)[0]), noise, which)


class Simulation(Protocol):
    """What can be played: a description that travels to the workers once."""

    @property
    def horizon(self) -> int:
        """Most actions of an episode."""

    def spaces(self) -> tuple[Box, Box]:
        """Return the observation and the action space."""

    def play(self, driving: Sequence[Policy], explorations: list[Exploration]) -> list[Episode]:
        """Play episodes side by side and return them in the order asked for."""

    def summary(self, episode: Episode) -> dict[str, float]:
        """Return an episode's numbers, for tables and the progress bar."""

    def expected_seconds(self, lanes: int) -> float | None:
        """Return about how long a block of `lanes` episodes takes, compiling excluded; None if that is not known."""


@dataclass(frozen=True)
class JetFlows:
    """The cylinder with two jets: operators, baseline and task. One column of a batch per episode."""

    operators: Operators
    baseline: Baseline
    task: Task

    @property
    def horizon(self) -> int:
        return self.task.actions_per_episode

    def spaces(self) -> tuple[Box, Box]:
        return spaces(self.operators.case, self.task)

    def play(self, driving: Sequence[Policy], explorations: list[Exploration]) -> list[Episode]:
        flows = ControlledFlow(self.operators, self.baseline, self.task, len(explorations))
        horizon, count = self.horizon, len(explorations)
        noise = np.stack([exploration.noise for exploration in explorations], axis=1)
        which = np.stack([exploration.which for exploration in explorations], axis=1)
        versions = np.array([policy.version for policy in driving])[which]
        observation = flows.observe()
        observations = np.empty((horizon + 1, *observation.shape), np.float32)
        actions = np.empty((horizon, count, 1), np.float32)
        log_probs, rewards, c_d, c_l, jets = (np.empty((horizon, count)) for _ in range(5))
        length = np.full(count, horizon)
        diverged = np.zeros(count, dtype=bool)
        observations[0] = observation
        flow_seconds = policy_seconds = 0.0
        for t in range(horizon):
            start = time.perf_counter()
            actions[t], log_probs[t] = policies.draw(driving, which[t], observations[t], noise[t])
            middle = time.perf_counter()
            outcome = flows.act(actions[t][:, 0])
            observations[t + 1] = flows.observe()
            rewards[t], c_d[t], c_l[t], jets[t] = outcome.reward, outcome.c_d, outcome.c_l, outcome.jet
            length[outcome.diverged & ~diverged] = t + 1
            diverged |= outcome.diverged
            policy_seconds += middle - start
            flow_seconds += time.perf_counter() - middle
            if diverged.all():
                break

        def one(b: int, index: int) -> Episode:
            def cut(series: np.ndarray) -> np.ndarray:
                return series[: length[b], b].copy()

            return Episode(
                index,
                cut(versions),
                cut(observations),
                observations[length[b], b].copy(),
                cut(actions),
                cut(log_probs),
                cut(rewards),
                {"c_d": cut(c_d), "c_l": cut(c_l), "jets": cut(jets)},
                bool(diverged[b]),
                flow_seconds / count,
                policy_seconds / count,
            )

        return [one(b, exploration.index) for b, exploration in enumerate(explorations)]

    def summary(self, episode: Episode) -> dict[str, float]:
        """Return means of C_D and C_L over the episode and its second half, and the jet's rms in units of its limit."""
        numbers, half = {}, len(episode.rewards) // 2
        for name in ("c_d", "c_l"):
            numbers[name] = float(episode.readings[name].mean())
            numbers[f"{name}_second_half"] = float(episode.readings[name][half:].mean())
        jets = episode.readings["jets"]
        return numbers | {"jet_rms": math.sqrt(float(np.mean(jets**2))) / self.task.max_flow_rate}

    def expected_seconds(self, lanes: int) -> float | None:
        flows = ControlledFlow(self.operators, self.baseline, self.task, lanes)
        still = np.zeros(lanes)
        flows.act(still)  # compiles, or loads what was compiled
        start = time.perf_counter()
        flows.act(still)
        flows.observe()
        return self.horizon * (time.perf_counter() - start)
