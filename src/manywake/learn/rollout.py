"""Episodes: what the learner asks for. An episode is a function of its arguments only."""

import time
from dataclasses import dataclass

import numpy as np

from manywake.env.task import ControlledFlow, Task
from manywake.flow import baseline
from manywake.flow.case import Case
from manywake.learn import policy as policies
from manywake.learn.policy import Policy


@dataclass(frozen=True)
class Episode:
    """One finished episode of T actions.

    observations: (T, values) before each action, last_observation: (values,) after the last. actions: (T, 1) as drawn,
    before clipping, with their log_probs (T,). rewards, c_d, c_l, jets: (T,). terminated: the flow blew up at the last
    action; otherwise the horizon was reached. policy_version: that of the policy it was played with, to its end.
    flow_seconds, policy_seconds: this episode's share of its block's time.
    """

    index: int
    policy_version: int
    observations: np.ndarray
    last_observation: np.ndarray
    actions: np.ndarray
    log_probs: np.ndarray
    rewards: np.ndarray
    c_d: np.ndarray
    c_l: np.ndarray
    jets: np.ndarray
    terminated: bool
    flow_seconds: float
    policy_seconds: float


def seed_sequence(run_seed: int, episode: int) -> np.random.SeedSequence:
    """Return the seed of one episode's exploration: it names the episode, not the process that plays it."""
    return np.random.SeedSequence(run_seed, spawn_key=(episode,))


def rollout(case: Case, task: Task, policy: Policy, run_seed: int, episodes: list[int]) -> list[Episode]:
    """Play episodes side by side, one column each, and return them in the order asked for."""
    ops, base = baseline.assembled(case)
    flows = ControlledFlow(ops, base, task, len(episodes))
    horizon, count = task.actions_per_episode, len(episodes)
    noise = np.stack(
        [np.random.default_rng(seed_sequence(run_seed, k)).standard_normal((horizon, 1)) for k in episodes], axis=1
    )
    observation = flows.observe()
    observations = np.empty((horizon + 1, *observation.shape), np.float32)
    actions = np.empty((horizon, count, 1), np.float32)
    per_action = {name: np.empty((horizon, count)) for name in ("log_probs", "rewards", "c_d", "c_l", "jets")}
    length = np.full(count, horizon)
    diverged = np.zeros(count, dtype=bool)
    observations[0] = observation
    flow_seconds = policy_seconds = 0.0
    for t in range(horizon):
        start = time.perf_counter()
        mean = policies.act(policy, observations[t])
        actions[t], per_action["log_probs"][t] = policies.sample(policy, mean, noise[t])
        middle = time.perf_counter()
        outcome = flows.act(actions[t][:, 0])
        observations[t + 1] = flows.observe()
        for name, values in (
            ("rewards", outcome.reward),
            ("c_d", outcome.c_d),
            ("c_l", outcome.c_l),
            ("jets", outcome.jet),
        ):
            per_action[name][t] = values
        length[outcome.diverged & ~diverged] = t + 1
        diverged |= outcome.diverged
        policy_seconds += middle - start
        flow_seconds += time.perf_counter() - middle
        if diverged.all():
            break
    return [
        Episode(
            index,
            policy.version,
            observations[: length[b], b].copy(),
            observations[length[b], b].copy(),
            actions[: length[b], b].copy(),
            terminated=bool(diverged[b]),
            flow_seconds=flow_seconds / count,
            policy_seconds=policy_seconds / count,
            **{name: values[: length[b], b].copy() for name, values in per_action.items()},
        )
        for b, index in enumerate(episodes)
    ]
