"""How episodes are collected, and all that decides a training beside what is played."""

import math
from dataclasses import dataclass
from typing import Literal

from manywake.case.learning import Learning


@dataclass(frozen=True)
class Collection:
    """How and where episodes are collected.

    Synced, or on the virtual clock, neither engine, workers nor lanes changes a result; synced, envs does not either.
    """

    schedule: Literal["synced", "unsynced"] = "synced"
    """synced: the episodes of an update are all played by one policy, and waited for. unsynced: every environment
    goes on at once with the newest policy: over-parallelisation."""
    clock: Literal["real", "virtual"] = "real"
    """Whose order unsynced episodes come in: the machine's, or that of modelled durations, which is reproducible."""
    newest_policy: Literal["episode", "action"] = "episode"
    """When an unsynced environment takes the newest policy: to begin an episode, or for every action. For every
    action only on the virtual clock, where it is known beforehand which policy that is."""
    envs: int | None = None
    """Environments, N; as many as episodes of an update when none of envs, workers and lanes is given."""
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
    """Virtual clock: mean duration of an episode, in seconds."""
    episode_spread: float = 0.005
    """Virtual clock: standard deviation of the durations, relative to the mean."""
    update_seconds: float = 0.3
    """Virtual clock: duration of an update, in seconds."""

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
            if value is not None and not 0 < value < math.inf:
                raise ValueError(f"{name}: got {value:g}, wanted more than 0")
        for name in ("episode_spread", "update_seconds"):
            if not 0 <= (value := getattr(self, name)) < math.inf:
                raise ValueError(f"{name}: got {value:g}, wanted a number, at least 0")


@dataclass(frozen=True)
class Settings:
    """All that decides a run's result beside the simulation, and how it is come by."""

    learning: Learning
    collection: Collection
    seed: int

    def __post_init__(self) -> None:
        if not 0 <= self.seed < 2**32:
            raise ValueError(f"seed: got {self.seed}, wanted a whole number from 0 to {2**32 - 1}")
