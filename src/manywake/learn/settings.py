"""All that decides a training: case, task, learner, seed. Free of torch, so that asking for help is quick."""

from dataclasses import dataclass
from typing import Literal

from manywake.env.task import TASKS, Task
from manywake.flow.case import Case


@dataclass(frozen=True)
class Learning:
    """Settings of the learner; names are Stable-Baselines3's where it has one."""

    update_period: int = 16
    """Episodes per update, T_L of the paper, which has 20. 16 are a block of eight lanes for each of two cores."""
    episodes: int = 256
    """Episodes in all."""
    learning_rate: float = 5e-4
    """Adam's step at the first update."""
    learning_rate_end: float = 0.0
    """Adam's step one update past the last; linear in the episode count between."""
    n_epochs: int = 5
    batch_size: int = 320
    gamma: float = 0.99
    gae_lambda: float = 0.97
    clip_range: float = 0.2
    ent_coef: float = 0.0
    """Entropy bonus. None by default: with the paper's 0.01 the exploration noise does not die down."""
    ratio_to: Literal["behaviour", "current"] = "behaviour"
    """What the clipped probability ratio is to: the policy that drew the action, or, as in the paper's Tensorforce, the
    one about to be updated, however old the episode is. Synced they differ by the update of the normaliser alone."""
    vf_coef: float = 0.5
    max_grad_norm: float = 0.5
    log_std_init: float = -1.5
    """Logarithm of the initial exploration noise, in units of the action's half range."""
    patience: int | None = None
    """Updates in a row without a better mean reward of an update's episodes, after which training stops by itself;
    never when not given."""
    hidden: tuple[int, ...] = (256, 256)
    """ReLU layers of policy and critic each. The paper's 512, 512 take the learner two and a half times as long."""
    learner_threads: int = 1
    """Threads of the learner: a constant and not the core count, because the sums of torch depend on it. At these sizes
    two that sleep while they wait for each other take longer than one."""

    def __post_init__(self) -> None:
        if self.patience is not None and self.patience < 1:
            raise ValueError(f"patience: got {self.patience}, wanted at least 1 update, or none to train to the end")
        if self.episodes % self.update_period or self.episodes < self.update_period:
            raise ValueError(
                f"episodes: got {self.episodes}, wanted a multiple of the update period {self.update_period}"
            )


PAPER_LEARNING = Learning(
    update_period=20,
    episodes=400,
    learning_rate=1e-3,
    learning_rate_end=1e-3,
    batch_size=320,
    ent_coef=0.01,
    log_std_init=-1.0,
    hidden=(512, 512),
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
class Collection:
    """How and where episodes are collected.

    Synced, or on the virtual clock, neither engine, workers nor lanes changes a result; synced, envs does not either.
    """

    schedule: Literal["synced", "unsynced"] = "synced"
    """synced: the episodes of an update are all played by one policy, and waited for. unsynced: every environment
    goes on at once with the newest policy (paper, section 3.3: over-parallelisation)."""
    clock: Literal["real", "virtual"] = "real"
    """Whose order unsynced episodes come in: the machine's, or that of modelled durations, which is reproducible."""
    newest_policy: Literal["episode", "action"] = "episode"
    """When an unsynced environment takes the newest policy: to begin an episode, or for every action, as the paper's
    runner does. For every action only on the virtual clock, where it is known beforehand which policy that is."""
    envs: int | None = None
    """Environments, N of the paper; as many as episodes of an update when none of envs, workers and lanes is given."""
    workers: int | None = None
    """Processes (or threads, or tasks of Ray at once) that they are spread over; worked out when not given."""
    lanes: int | None = None
    """Environments that a worker advances side by side; worked out when not given."""
    engine: Literal["processes", "serial", "threads", "ray"] = "processes"
    """Where episodes are played. serial: in one thread of the trainer."""
    address: str | None = None
    """Address of a running Ray cluster; auto finds it. Without one Ray is started on this machine."""
    cpus_per_env: float = 1.0
    """Cores that a block of environments takes, told to Ray: more than one for a simulation that runs on MPI."""
    time_limit: float | None = None
    """Seconds that a block may take until its worker is replaced; worked out from what an episode takes."""
    episode_seconds: float = 5.0
    """Virtual clock: mean duration of an episode."""
    episode_spread: float = 0.005
    """Virtual clock: standard deviation of the durations, relative to the mean."""
    update_seconds: float = 0.3
    """Virtual clock: duration of an update."""

    def __post_init__(self) -> None:
        if self.newest_policy == "action" and (self.schedule, self.clock) != ("unsynced", "virtual"):
            raise ValueError(
                f"newest_policy: got action with schedule {self.schedule} and clock {self.clock}, wanted it with "
                "--schedule unsynced --clock virtual"
            )
        if self.address is not None and self.engine != "ray":
            raise ValueError(f"address: got {self.address!r} with engine {self.engine}, wanted it with --engine ray")
        for name in ("episode_seconds", "cpus_per_env", "time_limit"):
            value = getattr(self, name)
            if value is not None and value <= 0:
                raise ValueError(f"{name}: got {value:g}, wanted more than 0")


@dataclass(frozen=True)
class Settings:
    """All that decides a run's result, and how it is come by.

    env: another simulation, `module:factory` or an id registered with Gymnasium, in place of case and task, of which
    only actions_per_episode is then used, unless the environment has a limit of its own. env_folder: where its module
    is looked for.
    """

    case: Case
    task: Task
    learning: Learning
    collection: Collection
    seed: int
    env: str | None = None
    env_folder: str = "."
