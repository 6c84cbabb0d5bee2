"""The Gymnasium environments of any flow: a single one, and the ids of all."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode

from manywake.case.case import Case
from manywake.case.task import Task
from manywake.env.control import spaces
from manywake.env.vector import COEFFICIENTS, RENDERED, FlowVectorEnv, VectorState, checked, next_seed
from manywake.suite import load


@dataclass(frozen=True)
class State:
    """All that the future of one flow depends on, but for its actions; of `FlowEnv.get_state`."""

    batch: VectorState
    random: Mapping[str, Any]
    under_way: bool


class FlowEnv(gymnasium.Env):
    """One flow under control: `FlowVectorEnv` with a batch of one."""

    metadata = {**RENDERED, "coefficients": COEFFICIENTS}

    def __init__(
        self,
        case: str | Path | Case = load.DEFAULT,
        task: Task | str | None = None,
        render_mode: str | None = None,
        **overrides: Any,
    ):
        self._batch = FlowVectorEnv(1, case, task, AutoresetMode.DISABLED, render_mode, **overrides)
        self.render_mode = render_mode
        self.observation_space, self.action_space = spaces(self.case, self.task)
        self._under_way = False

    @property
    def case(self) -> Case:
        return self._batch.case

    @property
    def task(self) -> Task:
        return self._batch.task

    def get_state(self) -> State:
        """Return all that the flow's future depends on, to the bit; it pickles."""
        return State(self._batch.get_state(), self.np_random.bit_generator.state, self._under_way)

    def set_state(self, state: State) -> None:
        """Go back to a state of `get_state`, of this environment or of another of the same case and task."""
        self._batch.set_state(state.batch)
        self.np_random.bit_generator.state = state.random
        self._under_way = state.under_way

    def render(self) -> np.ndarray | None:  # type: ignore[override]
        """Return a picture of the flow, (height, width, 3) uint8; with the mode human show it and return None."""
        pictures = self._batch.render()
        return None if pictures is None else pictures[0]

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """Begin the episode of a seed; without one, that of a seed drawn from `np_random`."""
        super().reset(seed=seed, options=options)
        observation, info = self._batch.reset(seed=next_seed(self.np_random) if seed is None else seed)
        self._under_way = True
        return observation[0], _single(info)

    def step(self, action):
        """Hold the action for one action interval."""
        if not self._under_way:
            raise ValueError("step: got an action while no episode is under way, wanted reset() first")
        checked(action, self.action_space.shape)
        observation, reward, terminated, truncated, info = self._batch.step(np.asarray(action)[None])
        self._under_way = not (terminated[0] or truncated[0])
        return observation[0], float(reward[0]), bool(terminated[0]), bool(truncated[0]), _single(info)

    def close(self):
        """End what is under way, and close the window."""
        self._under_way = False
        self._batch.close_extras()


def _single(info: dict[str, Any]) -> dict[str, Any]:
    """Return the info of a batch of one without the batch axis, as NumPy's arrays and scalars, which have types."""
    return {key: value[0] for key, value in info.items() if not key.startswith("_") and info[f"_{key}"][0]}


def register() -> None:
    """Tell Gymnasium of `manywake/Flow-v0`, any case, and of an id for each shipped flow."""
    shipped = (
        "cylinder-jets",
        "fluidgym-cylinder",
        "free-cylinder-jets",
        "free-cylinder-rotation",
        "pinball",
        "square-jets",
        "step",
    )
    ids: dict[str, dict[str, Any]] = {"Flow": {}}
    ids |= {name.title().replace("-", ""): {"case": name} for name in shipped}
    for name, settings in ids.items():
        single, vector = f"{__name__}:FlowEnv", f"{FlowVectorEnv.__module__}:FlowVectorEnv"
        gymnasium.register(f"manywake/{name}-v0", single, vector_entry_point=vector, kwargs=settings)
