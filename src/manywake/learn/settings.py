"""All that decides a training: case, task, learner, seed. Free of torch, so that asking for help is quick."""

from dataclasses import dataclass

from manywake.env.task import TASKS, Task
from manywake.flow.case import Case


@dataclass(frozen=True)
class Learning:
    """Settings of the learner; names are Stable-Baselines3's where it has one."""

    update_period: int = 20
    """Episodes per update, T_L of the paper."""
    episodes: int = 320
    """Episodes in all."""
    learning_rate: float = 5e-4
    """Adam's step at the first update."""
    learning_rate_end: float = 0.0
    """Adam's step one update past the last; linear in the episode count between."""
    n_epochs: int = 5
    batch_size: int = 400
    gamma: float = 0.99
    gae_lambda: float = 0.97
    clip_range: float = 0.2
    ent_coef: float = 0.0
    """Entropy bonus. None by default: with the paper's 0.01 the exploration noise does not die down."""
    vf_coef: float = 0.5
    max_grad_norm: float = 0.5
    log_std_init: float = -1.0
    """Logarithm of the initial exploration noise, in units of the action's half range."""
    hidden: tuple[int, ...] = (512, 512)
    """ReLU layers of policy and critic each (paper, section 2.2)."""
    learner_threads: int = 2
    """Threads of the learner: a constant and not the core count, because the sums of torch depend on it."""

    def __post_init__(self) -> None:
        if self.episodes % self.update_period or self.episodes < self.update_period:
            raise ValueError(
                f"episodes: got {self.episodes}, wanted a multiple of the update period {self.update_period}"
            )


PAPER_LEARNING = Learning(
    episodes=400,
    learning_rate=1e-3,
    learning_rate_end=1e-3,
    batch_size=320,
    ent_coef=0.01,
)
"""As the paper's released code: 400 episodes, constant step 1e-3, 25 minibatches of a fifth of the batch an update.

What stays SB3's: a Gaussian and not a Beta policy, generalised advantages, one optimiser for policy and critic.
"""

PROTOCOLS: dict[str, tuple[Task, Learning]] = {
    "default": (TASKS["default"], Learning()),
    "paper": (TASKS["paper"], PAPER_LEARNING),
    "code": (TASKS["code"], PAPER_LEARNING),
}
"""Task and learner by name: ours, the paper's, and those of the paper's released code."""


@dataclass(frozen=True)
class Settings:
    """All that decides a run's result."""

    case: Case
    task: Task
    learning: Learning
    seed: int
