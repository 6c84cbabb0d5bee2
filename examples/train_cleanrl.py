"""The cylinder's jets under PPO in one file, as CleanRL writes it: every line of the algorithm is here.

    python examples/train_cleanrl.py --seed 0

The batch is Gymnasium's `make_vec`. Its step after an episode's end is the reset: the action does nothing there and the
reward is 0. Such steps are in the rollout, and the mask `played` keeps them out of the loss.
"""

import gymnasium
import numpy as np
import torch
import tyro
from gymnasium.wrappers.vector import NormalizeObservation
from torch import nn
from torch.distributions import Normal

GAMMA, LAMBDA, CLIP, EPOCHS, MINIBATCHES, RATE = 0.99, 0.97, 0.2, 5, 8, 5e-4


class Agent(nn.Module):
    """A Gaussian policy and a value, two networks of two layers."""

    def __init__(self, values: int, actions: int):
        super().__init__()

        def layers(out: int, scale: float) -> nn.Sequential:
            last = nn.Linear(256, out)
            nn.init.orthogonal_(last.weight, scale)
            nn.init.zeros_(last.bias)
            return nn.Sequential(nn.Linear(values, 256), nn.ReLU(), nn.Linear(256, 256), nn.ReLU(), last)

        self.mean, self.value = layers(actions, 0.01), layers(1, 1.0)
        self.log_std = nn.Parameter(torch.full((actions,), -1.5))

    def policy(self, seen: torch.Tensor) -> Normal:
        return Normal(self.mean(seen), self.log_std.exp())


def train(episodes: int = 256, flows: int = 16, actions: int = 160, interval: float = 0.025, seed: int = 0) -> float:
    """Train; return the drag that the policy without noise saves in the second half of an episode, a share.

    Args:
        episodes: In all.
        flows: Side by side; an update is made of an episode of each.
        actions: Horizon of an episode.
        interval: Time between actions.
        seed: Of weights, exploration and episodes.
    """
    torch.manual_seed(seed)
    torch.set_num_threads(1)  # networks this small are slower on more
    given = {"actions": actions, "interval": interval}
    batch = NormalizeObservation(gymnasium.make_vec("manywake:manywake/CylinderJets-v0", num_envs=flows, **given))
    agent = Agent(batch.single_observation_space.shape[0], batch.single_action_space.shape[0])
    optimizer = torch.optim.Adam(agent.parameters(), RATE, eps=1e-5)
    steps, updates = actions + 1, episodes // flows
    seen, _ = batch.reset(seed=seed)
    ended = np.zeros(flows, bool)
    for update in range(updates):
        optimizer.param_groups[0]["lr"] = RATE * (1 - update / updates)
        rows = []
        for _ in range(steps):
            now = torch.as_tensor(seen, dtype=torch.float32)
            with torch.no_grad():
                policy = agent.policy(now)
                action = policy.sample()
                log_prob, value = policy.log_prob(action).sum(1), agent.value(now)[:, 0]
            seen, reward, terminated, truncated, info = batch.step(action.numpy())
            over, played, ended = terminated | truncated, ~ended, terminated | truncated
            with torch.no_grad():
                following = agent.value(torch.as_tensor(seen, dtype=torch.float32))[:, 0] * torch.as_tensor(~terminated)
            flags = torch.as_tensor(reward, dtype=torch.float32), torch.as_tensor(~over), torch.as_tensor(played)
            rows.append((now, action, log_prob, value, following, *flags))
        states, acted, old, values, following, rewards, goes_on, played = map(torch.stack, zip(*rows, strict=True))
        advantages, last = torch.zeros_like(rewards), torch.zeros(flows)
        for t in reversed(range(steps)):
            delta = rewards[t] + GAMMA * following[t] - values[t]
            advantages[t] = last = delta + GAMMA * LAMBDA * goes_on[t] * last
        returns = (advantages + values)[played]
        states, acted, old, advantages = states[played], acted[played], old[played], advantages[played]
        for _ in range(EPOCHS):
            for some in torch.randperm(len(states)).chunk(MINIBATCHES):
                policy = agent.policy(states[some])
                ratio = (policy.log_prob(acted[some]).sum(1) - old[some]).exp()
                gain = (advantages[some] - advantages[some].mean()) / (advantages[some].std(correction=0) + 1e-8)
                loss = -torch.min(ratio * gain, ratio.clamp(1 - CLIP, 1 + CLIP) * gain).mean()
                loss = loss + 0.5 * (agent.value(states[some])[:, 0] - returns[some]).square().mean()
                optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
                optimizer.step()
        print(f"{(update + 1) * flows:4d} episodes, reward of an action {rewards[played].mean():+.4f}", flush=True)
    return saved(agent, batch, given, seed)


def saved(agent: Agent, batch: NormalizeObservation, given: dict, seed: int) -> float:
    """Return the share of the drag that the policy without noise saves, in the second half of an episode."""
    pair, drag = gymnasium.make_vec("manywake:manywake/CylinderJets-v0", num_envs=2, **given), []
    seen, _ = pair.reset(seed=seed)
    for _ in range(given["actions"]):
        scaled = (seen - batch.obs_rms.mean) / np.sqrt(batch.obs_rms.var + batch.epsilon)
        with torch.no_grad():
            action = agent.mean(torch.as_tensor(scaled, dtype=torch.float32))
        seen, _, _, _, info = pair.step(action.numpy() * [[1.0], [0.0]])  # the second flow is left alone
        drag.append(info["c_d"])
    controlled, free = np.mean(drag[len(drag) // 2 :], axis=0)
    print(f"drag saved: {1 - controlled / free:.2%}")
    return float(1 - controlled / free)


if __name__ == "__main__":
    tyro.cli(train)
