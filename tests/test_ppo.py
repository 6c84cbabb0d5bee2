"""The learner: stock PPO on whole episodes, with the normaliser in the policy."""

from dataclasses import replace

import numpy as np
import torch
from stable_baselines3 import PPO

from manywake.learn import policy as policies
from manywake.learn import ppo, schedule
from manywake.learn.blocks import Layout

from .toy import LEARNING, Toy, collector

HORIZON = Toy().horizon


def trained(updates: int = 10, **toy) -> ppo.EpisodicPPO:
    model = ppo.build(LEARNING, collector(**toy))
    model.learn(updates * LEARNING.update_period * HORIZON)
    return model


def test_it_learns_a_toy_task():
    returns = []
    model = ppo.build(LEARNING, collector())
    model.hooks.collected = lambda model, episodes: returns.append(np.mean([e.rewards.sum() for e in episodes]))
    model.learn(100 * HORIZON)
    assert returns[-1] > 0.4 * returns[0]  # both negative: the distance from zero has more than halved


def test_the_same_seed_gives_the_same_policy_and_another_seed_another():
    assert ppo.digest(trained(2)) == ppo.digest(trained(2))
    assert ppo.digest(trained(2)) != ppo.digest(trained(2, run_seed=1))


def test_normaliser_has_the_statistics_of_all_it_has_seen():
    rng = np.random.default_rng(0)
    batches = [rng.normal(3.0, 2.0, (n, 3)).astype(np.float32) for n in (50, 7, 200)]
    norm = ppo.RunningNorm(Toy().spaces()[0])
    for batch in batches:
        norm.update(batch)
    seen = np.concatenate(batches).astype(np.float64)
    np.testing.assert_allclose(norm.mean.numpy(), seen.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(norm.variance.numpy(), seen.var(axis=0), rtol=1e-12)


def test_a_plain_zip_predicts_from_raw_observations(tmp_path):
    model = trained(2)
    model.save(tmp_path / "model.zip")
    loaded = PPO.load(tmp_path / "model.zip", device="cpu")
    observations = np.random.default_rng(1).normal(3.0, 2.0, (5, 3)).astype(np.float32)
    action, _ = loaded.predict(observations, deterministic=True)
    ours = np.clip(policies.act(ppo.snapshot(model), observations), -1, 1)
    np.testing.assert_allclose(action, ours, rtol=0, atol=1e-5)


def test_episodes_of_unequal_length_enter_whole_and_only_truncation_bootstraps():
    model = ppo.build(LEARNING, collector(Toy(terminate_every=3)))
    seen = []
    model.hooks.collected = lambda model, episodes: seen.extend(episodes)
    model.learn(1)
    buffer = model.rollout_buffer
    lengths = [len(episode.rewards) for episode in seen]
    assert set(lengths) == {HORIZON, HORIZON // 2}
    starts = np.concatenate([[0], np.cumsum(lengths)[:-1]])
    np.testing.assert_array_equal(np.flatnonzero(buffer.episode_starts[:, 0]), starts)
    for episode, start in zip(seen, starts, strict=True):
        last = start + len(episode.rewards) - 1
        bootstrap = buffer.rewards.reshape(-1)[last] - np.float32(episode.rewards[-1])
        assert (bootstrap == 0) == episode.terminated


def test_advantages_are_those_of_generalised_advantage_estimation():
    """The definition, episode by episode: a sum of discounted temporal differences."""
    model = ppo.build(LEARNING, collector(Toy(terminate_every=4)))
    seen = []
    model.hooks.collected = lambda model, episodes: seen.extend(episodes)
    before = {}
    train = model.train

    def remember():
        before["values"] = model.rollout_buffer.values.reshape(-1).astype(float).copy()
        before["advantages"] = model.rollout_buffer.advantages.reshape(-1).copy()
        with torch.no_grad():
            ends = torch.from_numpy(np.stack([e.last_observation for e in seen]))
            before["ends"] = model.policy.predict_values(ends).numpy()[:, 0]
        train()

    model.train = remember
    model.learn(1)
    k = 0
    for episode, end in zip(seen, before["ends"], strict=True):
        n = len(episode.rewards)
        values = np.append(before["values"][k : k + n], 0.0 if episode.terminated else end)
        delta = episode.rewards + model.gamma * values[1:] - values[:-1]
        weights = model.gamma * model.gae_lambda
        naive = [sum(weights**j * delta[t + j] for j in range(n - t)) for t in range(n)]
        np.testing.assert_allclose(before["advantages"][k : k + n], naive, rtol=0, atol=1e-4)
        k += n


def test_a_ratio_to_the_current_policy_begins_at_one_however_old_the_episodes_are():
    """With one minibatch and one epoch nothing can be clipped yet, unless the ratio is to an older policy."""
    plan = schedule.unsynced(np.full(100, 5.0), 30, 10, 0.1)
    found = {}
    for reference in ("behaviour", "current"):
        learning = replace(LEARNING, ratio_to=reference, n_epochs=1, batch_size=10 * HORIZON)
        model = ppo.build(learning, collector(learning=learning, grid=Layout(30, 1, 30), plan=plan))
        before, clipped = [], []

        def updated(model, episodes, before=before, clipped=clipped):
            before.append(model.clipped_before)
            clipped.append(model.logger.name_to_value["train/clip_fraction"])

        model.hooks.updated = updated
        model.learn(100 * HORIZON)
        found[reference] = max(before), max(clipped)
    assert found["behaviour"][0] > 0.05 and found["behaviour"][1] > 0.05
    assert found["current"][0] > 0.05 and found["current"][1] == 0.0


def test_learning_rate_falls_linearly_with_the_episodes():
    model = ppo.build(LEARNING, collector())
    rates = []
    train = model.train

    def remember():
        train()
        rates.append(model.policy.optimizer.param_groups[0]["lr"])

    model.train = remember
    model.learn(100 * HORIZON)
    np.testing.assert_allclose(rates, 3e-3 * (1 - np.arange(10) / 10), atol=1e-12)
