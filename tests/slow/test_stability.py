"""The default case stays finite whatever an exploring policy does, and nearly so at the worst it could do."""

import numpy as np

from manywake.env.task import ControlledFlow, Task
from manywake.flow import baseline
from manywake.flow.case import CASES

EPISODES = 56
"""Whole blocks of eight, and at least the fifty that were asked for."""


def play(action):
    """Play whole episodes with action(rng, flows) at every step; return how many flows blew up and the largest C_D."""
    ops, base = baseline.assembled(CASES["cylinder-jets"])
    flows, rng = ControlledFlow(ops, base, Task(), EPISODES), np.random.default_rng(0)
    diverged, largest = np.zeros(EPISODES, bool), 0.0
    for _ in range(Task().actions_per_episode):
        outcome = flows.act(action(rng, EPISODES))
        diverged |= outcome.diverged
        largest = max(largest, float(np.nanmax(outcome.c_d)))
    return int(diverged.sum()), largest


def test_no_episode_of_uniform_random_actions_at_full_strength_diverges():
    diverged, largest = play(lambda rng, flows: rng.uniform(-1, 1, flows))
    assert diverged == 0 and largest < 10


def test_hardly_an_episode_of_full_jets_of_random_sign_diverges():
    diverged, _ = play(lambda rng, flows: rng.choice([-1.0, 1.0], flows))
    assert diverged <= 3  # measured: 0 and 1 of 56
