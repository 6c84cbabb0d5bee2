"""Settings of the learner. Free of torch, so that asking for help is quick."""

from dataclasses import dataclass
from numbers import Integral
from typing import Literal

LEAST = {"update_period": 1, "episodes": 1, "n_epochs": 1, "batch_size": 2, "learner_threads": 1}
"""Whole numbers, and the least that they may be; of one sample no advantage can be normalised."""
BETWEEN = {
    "learning_rate": (1e-12, 1.0),
    "learning_rate_end": (0.0, 1.0),
    "gamma": (0.0, 1.0),
    "gae_lambda": (0.0, 1.0),
    "clip_range": (1e-6, 1e6),
    "ent_coef": (0.0, 1e6),
    "vf_coef": (0.0, 1e6),
    "max_grad_norm": (1e-12, 1e12),
    "log_std_init": (-20.0, 2.0),
}
"""Numbers, and what they may be from and to."""


@dataclass(frozen=True)
class Learning:
    """Settings of the learner, PPO on whole episodes; names are Stable-Baselines3's where it has one."""

    update_period: int = 16
    """Episodes per update, T_L. 16 are a block of eight lanes for each of two cores."""
    episodes: int = 256
    """Episodes in all."""
    learning_rate: float = 5e-4
    """Adam's step at the first update."""
    learning_rate_end: float = 0.0
    """Adam's step one update past the last; linear in the episode count between."""
    n_epochs: int = 5
    """Passes over an update's samples."""
    batch_size: int = 320
    """Samples of a minibatch."""
    gamma: float = 0.99
    """Discount of a reward one action later."""
    gae_lambda: float = 0.97
    """Weight of later estimates in the generalised advantage."""
    clip_range: float = 0.2
    """How far the probability ratio may go from 1 before it no longer counts."""
    ent_coef: float = 0.0
    """Entropy bonus. None by default: with 0.01 the exploration noise does not die down."""
    ratio_to: Literal["behaviour", "current"] = "behaviour"
    """What the clipped probability ratio is to: the policy that drew the action, or the one about to be updated,
    however old the episode is. Synced they differ by the update of the normaliser alone."""
    vf_coef: float = 0.5
    """Weight of the critic's loss."""
    max_grad_norm: float = 0.5
    """Norm that gradients are cut to."""
    log_std_init: float = -1.5
    """Logarithm of the initial exploration noise, in units of the action's half range."""
    patience: int | None = None
    """Updates in a row without a better mean reward of an update's episodes, after which training stops by itself;
    never when not given."""
    hidden: tuple[int, ...] = (256, 256)
    """Units of the hidden layers, of policy and critic each; ReLU between them."""
    learner_threads: int = 1
    """Threads of the learner: a constant and not the core count, because the sums of torch depend on it. At these sizes
    two that sleep while they wait for each other take longer than one."""

    def __post_init__(self) -> None:
        if self.patience is not None and (not isinstance(self.patience, Integral) or self.patience < 1):
            raise ValueError(f"patience: got {self.patience}, wanted at least 1 update, or none to train to the end")
        for name, least in LEAST.items():
            if not isinstance(value := getattr(self, name), Integral) or value < least:
                raise ValueError(f"{name}: got {value}, wanted a whole number, at least {least}")
        if any(not isinstance(units, Integral) or units < 1 for units in self.hidden):
            raise ValueError(f"hidden: got {self.hidden}, wanted whole numbers, each at least 1")
        for name, (low, high) in BETWEEN.items():
            if not low <= (value := getattr(self, name)) <= high:
                raise ValueError(f"{name}: got {value:g}, wanted a number from {low:g} to {high:g}")
        if self.episodes % self.update_period or self.episodes < self.update_period:
            raise ValueError(
                f"episodes: got {self.episodes}, wanted a multiple of the update period {self.update_period}"
            )
