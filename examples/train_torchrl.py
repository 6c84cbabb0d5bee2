"""The cylinder's jets under TorchRL's PPO: its collector, advantage and loss, on 16 flows side by side.

    python examples/train_torchrl.py --seed 0

TorchRL resets single flows of a batch itself, so the batch is made with its own autoreset disabled.
"""

import numpy as np
import torch
import tyro
from gymnasium.vector import AutoresetMode
from tensordict import TensorDict
from tensordict.nn import AddStateIndependentNormalScale, TensorDictModule, TensorDictSequential
from torch import nn
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, SamplerWithoutReplacement, TensorDictReplayBuffer
from torchrl.envs import Compose, GymWrapper, TransformedEnv, VecNormV2
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import IndependentNormal, ProbabilisticActor, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from manywake import FlowVectorEnv

RATE, EPOCHS, MINIBATCHES = 5e-4, 5, 8


def layers(values: int, out: int) -> nn.Sequential:
    """Return a network of two hidden layers whose first answers are near 0."""
    last = nn.Linear(256, out)
    nn.init.orthogonal_(last.weight, 0.01)
    nn.init.zeros_(last.bias)
    return nn.Sequential(nn.Linear(values, 256), nn.ReLU(), nn.Linear(256, 256), nn.ReLU(), last)


def opened(flows: int, **given) -> GymWrapper:
    """Return a batch as TorchRL takes it."""
    return GymWrapper(FlowVectorEnv(flows, autoreset_mode=AutoresetMode.DISABLED, **given))


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
    normal = VecNormV2(in_keys=["observation"], decay=0.9999, reduce_batch_dims=True)
    env = TransformedEnv(opened(flows, **given), Compose(normal))
    env.set_seed(seed)
    values, count = env.observation_spec["observation"].shape[-1], env.action_spec.shape[-1]
    network = nn.Sequential(layers(values, count), AddStateIndependentNormalScale(count, scale_mapping="exp"))
    nn.init.constant_(network[1].state_independent_scale, -1.5)
    actor = ProbabilisticActor(
        TensorDictModule(network, ["observation"], ["loc", "scale"]),
        in_keys=["loc", "scale"],
        distribution_class=IndependentNormal,
        return_log_prob=True,
    )
    critic = ValueOperator(layers(values, 1), in_keys=["observation"])
    advantage = GAE(gamma=0.99, lmbda=0.97, value_network=critic, average_gae=True)
    loss = ClipPPOLoss(actor, critic, entropy_bonus=False, critic_coeff=0.5, loss_critic_type="l2")
    optimizer = torch.optim.Adam(loss.parameters(), RATE, eps=1e-5)
    frames, updates = flows * actions, episodes // flows
    collector = Collector(
        env, actor, frames_per_batch=frames, total_frames=frames * updates, auto_register_policy_transforms=True
    )
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(frames), sampler=SamplerWithoutReplacement(), batch_size=max(frames // MINIBATCHES, 2)
    )
    for update, rollout in enumerate(collector):
        optimizer.param_groups[0]["lr"] = RATE * (1 - update / updates)
        with torch.no_grad():
            advantage(rollout)
        buffer.extend(rollout.reshape(-1))
        for _ in range(EPOCHS):
            for some in buffer:
                terms = loss(some)
                optimizer.zero_grad()
                (terms["loss_objective"] + terms["loss_critic"]).backward()
                nn.utils.clip_grad_norm_(loss.parameters(), 0.5)
                optimizer.step()
        reward = rollout["next", "reward"].mean().item()
        print(f"{(update + 1) * flows:4d} episodes, reward of an action {reward:+.4f}", flush=True)
    return saved(TensorDictSequential(normal.to_observation_norm(), actor), given, seed)


def saved(policy: TensorDictSequential, given: dict, seed: int) -> float:
    """Return the share of the drag that the policy without noise saves, in the second half of an episode."""
    pair, drag = FlowVectorEnv(2, **given), []
    seen, _ = pair.reset(seed=seed)
    for _ in range(given["actions"]):
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            action = policy(TensorDict(observation=torch.as_tensor(seen), batch_size=2))["action"]
        seen, _, _, _, info = pair.step(action.numpy() * [[1.0], [0.0]])  # the second flow is left alone
        drag.append(info["c_d"])
    controlled, free = np.mean(drag[len(drag) // 2 :], axis=0)
    print(f"drag saved: {1 - controlled / free:.2%}")
    return float(1 - controlled / free)


if __name__ == "__main__":
    tyro.cli(train)
