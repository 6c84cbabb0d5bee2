"""The policy that plays is the policy that learns: same weights, same actions, the same bits for every batch."""

import numpy as np
import pytest
import torch

from manywake.learn import policy as policies
from manywake.learn import ppo

from .toy import LEARNING, collector


@pytest.fixture
def model():
    made = ppo.build(LEARNING, collector())
    ppo.normaliser(made).update(np.random.default_rng(1).normal(2.0, 3.0, (500, 3)).astype(np.float32))
    with torch.no_grad():
        made.policy.action_net.weight.normal_(0.0, 0.3)
    return made


@pytest.fixture
def observations():
    return np.random.default_rng(2).normal(2.0, 3.0, (20, 3)).astype(np.float32)


def test_forward_pass_gives_the_actions_of_stable_baselines(model, observations):
    ours = policies.act(ppo.snapshot(model), observations)
    theirs = model.policy.get_distribution(torch.from_numpy(observations)).mode().detach().numpy()
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-5)


def test_log_probabilities_are_those_of_stable_baselines(model, observations):
    policy = ppo.snapshot(model)
    noise = np.random.default_rng(3).standard_normal((20, 1))
    actions, log_probs = policies.sample(policy, policies.act(policy, observations), noise)
    _, theirs, _ = model.policy.evaluate_actions(torch.from_numpy(observations), torch.from_numpy(actions))
    np.testing.assert_allclose(log_probs, theirs.detach().numpy(), rtol=0, atol=1e-4)


@pytest.mark.parametrize("batch", [1, 3, 8, 16, 20])
def test_an_action_has_the_same_bits_in_every_batch(model, observations, batch):
    policy = ppo.snapshot(model)
    whole = policies.act(policy, observations)
    parts = [policies.act(policy, observations[k : k + batch]) for k in range(0, 20, batch)]
    assert np.concatenate(parts).tobytes() == whole.tobytes()


def test_an_observation_that_is_not_a_number_stays_in_its_row(model, observations):
    policy = ppo.snapshot(model)
    clean = policies.act(policy, observations)
    observations[4] = np.nan
    spoilt = policies.act(policy, observations)
    assert np.isnan(spoilt[4]).all()
    np.testing.assert_array_equal(np.delete(spoilt, 4, axis=0), np.delete(clean, 4, axis=0))
