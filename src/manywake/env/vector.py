"""The Gymnasium environment of many flows: a true batch."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cloudpickle
import gymnasium
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from manywake.case.case import Case
from manywake.case.task import Task
from manywake.env.control import Snapshot, spaces
from manywake.env.pictures import MODES, SPEED, Pictures
from manywake.env.several import SeveralFlows
from manywake.flow import store
from manywake.suite import load

RENDERED = {"render_modes": list(MODES), "render_fps": SPEED}
COEFFICIENTS = "C = 2F / (rho U^2 L), force on the body; drag positive downstream, lift positive up"
_MADE_ANEW = ("_flows", "_pictures")
"""What an environment that is copied makes again in its new place."""


def _say(what: str, share: float) -> None:
    """Tell on the standard error how far the baseline of a new case is; in a file, what is done."""
    on_screen = sys.stderr.isatty()
    if on_screen or share >= 1:
        text = f"manywake: baseline, {what} {share:4.0%}"
        print(f"\r{text}" if on_screen else text, end="\n" if share >= 1 else "", file=sys.stderr, flush=True)


def next_seed(random: np.random.Generator) -> int:
    """Return the seed of the next episode of a flow whose generator this is."""
    return int(random.integers(2**32))


def checked(actions: Any, shape: tuple[int, ...]) -> np.ndarray:
    """Return actions as an array of this shape; ValueError where they are not, or not finite."""
    array = np.asarray(actions, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"action: got shape {array.shape}, wanted {shape}; numbers in [-1, 1], flows first")
    for bad in array[~np.isfinite(array)]:
        raise ValueError(f"action: got {bad}, wanted finite numbers in [-1, 1]; check the policy's output")
    return array


@dataclass(frozen=True)
class VectorState:
    """All that the future of a batch depends on, but for its actions; of `FlowVectorEnv.get_state`.

    flows: of each flow the place of its Reynolds number in the task's, and its state. random: of each flow's generator.
    ended, fresh, diverged: (B,). begun: whether there was a first reset.
    """

    flows: list[tuple[int, Snapshot]]
    random: list[Mapping[str, Any]]
    ended: np.ndarray
    fresh: np.ndarray
    diverged: np.ndarray
    begun: bool


class FlowVectorEnv(gymnasium.vector.VectorEnv):
    """B flows of one case in one process, advanced together.

    case: a shipped one by name, the path of a case file, or a `Case` (then with task=Task(...)). task: a protocol of
    the file by name, or a `Task`. Every other setting of the case and its task is an option, see `suite.load`.

    Observation (B, values): what `Task.observe` names. Action (B, actions) in [-1, 1]: mixed to amplitudes in units of
    their limits (`Task.mixing`). The horizon is `truncated`; a flow that blows up is `terminated` with a finite
    observation and a charge. An episode is a function of its seed and of the actions. After reset(seed=s) flow i has
    the episodes of a single environment that was reset with s + i: that of the seed, then those of seeds drawn from a
    generator of its own. `info` has, for the last action, every reading by name (means, absent before the first
    action, NaN when the flow blew up; their convention stands in `metadata["coefficients"]`), amplitudes (inputs), the
    Reynolds number, time and diverged.

    render_mode: rgb_array, then `render()` returns a picture of each flow, (height, width, 3) uint8; or human, a window
    (the extra `manywake[window]`) that follows every step. max_episode_steps: Gymnasium's word for `actions`, an
    episode's length. The environment pickles, can be copied, and runs in other processes.
    """

    metadata = {**RENDERED, "autoreset_mode": AutoresetMode.NEXT_STEP, "coefficients": COEFFICIENTS}

    def __init__(
        self,
        num_envs: int = 1,
        case: str | Path | Case = load.DEFAULT,
        task: Task | str | None = None,
        autoreset_mode: AutoresetMode = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        max_episode_steps: int | None = None,
        **overrides: Any,
    ):
        if max_episode_steps is not None:
            overrides["actions"] = max_episode_steps
        try:
            self._chosen = load.choose(case, task, **overrides)
        except load.UnknownSetting as error:  # in Python's words, which libraries look for that try a keyword
            raise TypeError(f"got an unexpected keyword argument {error.wanted}") from error
        self.num_envs, self.render_mode = num_envs, render_mode
        self.metadata = {**self.metadata, "autoreset_mode": AutoresetMode(autoreset_mode)}
        self.single_observation_space, self.single_action_space = spaces(self.case, self.task)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._open()
        self._ended, self._diverged = np.zeros((2, num_envs), dtype=bool)
        self._fresh = ~self._ended
        self._random = [seeding.np_random()[0] for _ in range(num_envs)]
        self._begun = False

    def _open(self) -> None:
        """Make the flows, and nothing that pictures need yet."""
        flows = [store.flow(case, _say) for case in self._chosen.cases]
        self._flows = SeveralFlows(flows, self.task, self.num_envs)
        self._pictures = Pictures(self._flows, self.render_mode)

    @property
    def case(self) -> Case:
        return self._chosen.case

    @property
    def task(self) -> Task:
        return self._chosen.task

    @property
    def autoreset_mode(self) -> AutoresetMode:
        return self.metadata["autoreset_mode"]

    def __getstate__(self) -> dict[str, Any]:
        kept = {name: value for name, value in vars(self).items() if name not in _MADE_ANEW}
        # what a user's file defines travels as what it is, not by the name of a module
        return kept | {"_chosen": cloudpickle.dumps(self._chosen), "_state": self.get_state()}

    def __setstate__(self, kept: dict[str, Any]) -> None:
        state = kept.pop("_state")
        vars(self).update(kept, _chosen=cloudpickle.loads(kept["_chosen"]))
        self._open()
        self.set_state(state)

    def get_state(self) -> VectorState:
        """Return all that the batch's future depends on, to the bit; it pickles."""
        each = range(self.num_envs)
        return VectorState(
            [(self._flows.which(b), self._flows.snapshot(b)) for b in each],
            [random.bit_generator.state for random in self._random],
            self._ended.copy(),
            self._fresh.copy(),
            self._diverged.copy(),
            self._begun,
        )

    def set_state(self, state: VectorState) -> None:
        """Go back to a state of `get_state`, of this environment or of another of the same case, task and size."""
        if len(state.flows) != self.num_envs:
            raise ValueError(f"state: got one of {len(state.flows)} flows, wanted one of {self.num_envs}")
        for b, (which, kept) in enumerate(state.flows):
            self._flows.restore(b, which, kept)
            self._random[b].bit_generator.state = state.random[b]
        self._ended, self._fresh, self._diverged = state.ended.copy(), state.fresh.copy(), state.diverged.copy()
        self._begun = state.begun

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Return a picture of each flow; with the mode human show them side by side and return None."""
        return self._pictures.render()

    def close_extras(self, **kwargs: Any) -> None:
        """Close the window, if there is one; Gymnasium asks for it too where the environment could not be made."""
        if "_pictures" in vars(self):
            self._pictures.close()

    def _restart(self, which: np.ndarray, given: Sequence[int | None] | None = None) -> None:
        """Begin the next episodes of the flows of a mask, of seeds that are given; a fresh flow has no readings yet."""
        columns, seeds = np.flatnonzero(which), []
        for column in columns.tolist():
            seed = None if given is None else given[column]
            if seed is not None:
                self._random[column] = seeding.np_random(seed)[0]
            seeds.append(next_seed(self._random[column]) if seed is None else seed)
            self._pictures.restart(column)
        self._flows.reset(columns, seeds)
        self._fresh[which], self._ended[which], self._diverged[which] = True, False, False

    def reset(self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None):
        """Begin an episode in all flows, or in those of options["reset_mask"].

        seed: of the first flow's episode, the others' being those that follow; or a seed, or None, for each flow. A
        flow without one goes on to the seed that its own generator draws.
        """
        if isinstance(seed, np.ndarray):
            seed = seed.tolist()
        if seed is None:
            given: list[int | None] = [None] * self.num_envs
        else:
            given = list(seed) if isinstance(seed, Sequence) else [seed + k for k in range(self.num_envs)]
        if len(given) != self.num_envs:
            raise ValueError(
                f"seed: got {len(given)}, wanted one for each of the {self.num_envs} flows, or one for all"
            )
        super().reset(seed=given[0], options=options)
        mask = (options or {}).get("reset_mask")
        mask = np.ones(self.num_envs, dtype=bool) if mask is None else np.asarray(mask)
        if mask.shape != (self.num_envs,) or mask.dtype != bool or not mask.any():
            raise ValueError(
                f"reset_mask: got {mask}, wanted {self.num_envs} booleans, one per flow, at least one True"
            )
        self._restart(mask, given)
        self._begun = True
        self._pictures.follow(self._fresh)
        return self._flows.observe(), self._info(mask)

    def step(self, actions):
        """Advance every flow by one action interval; what happens at an episode's end is the autoreset mode's."""
        action = checked(actions, (self.num_envs, *self.single_action_space.shape))
        if self.closed or not self._begun:
            raise ValueError(f"step: got actions {'after close()' if self.closed else 'before the first reset()'}")
        mode, ended = self.metadata["autoreset_mode"], self._ended.copy()
        if mode == AutoresetMode.DISABLED and ended.any():
            raise ValueError(
                f"step: flow {ended.argmax()} has ended; with autoreset disabled, call "
                'reset(options={"reset_mask": ...}) first'
            )
        reward, self._diverged, truncated = self._flows.act(action)
        self._fresh[:] = False
        if ended.any():  # with NEXT_STEP: their step is the reset
            self._restart(ended)
            reward[ended], truncated[ended] = 0.0, False
        terminated = self._diverged.copy()
        self._ended = terminated | truncated
        self._pictures.follow(self._fresh)
        observation, info = self._flows.observe(), self._info()
        if mode == AutoresetMode.SAME_STEP and self._ended.any():
            observation, info = self._restarted(observation, info)
        return observation, reward, terminated, truncated, info

    def _restarted(self, last: np.ndarray, info: dict[str, Any]) -> tuple[np.ndarray, dict[str, Any]]:
        """Start ended flows anew in the same step; return the new observation and info, with the last ones in it."""
        ended = self._ended.copy()
        final = np.full(self.num_envs, None, dtype=object)
        for column in np.flatnonzero(ended):
            final[column] = last[column].copy()
        final_info = info | {key: ended.copy() for key in info if key.startswith("_")}
        self._restart(ended)
        also = {"final_obs": final, "_final_obs": ended, "final_info": final_info, "_final_info": ended.copy()}
        return self._flows.observe(), self._info() | also

    def _info(self, there: np.ndarray | bool = True) -> dict[str, Any]:
        """Return the info of the last action, for the flows that are `there`."""
        there = np.full(self.num_envs, there)
        means = {name: np.where(self._fresh, 0.0, part) for name, part in self._flows.means.items()}
        now = {
            "amplitudes": self._flows.amplitude,
            "reynolds": self._flows.reynolds(),
            "time": self._flows.actions * self.task.interval,
            "diverged": self._diverged.copy(),
        }
        present = {f"_{name}": there & ~self._fresh for name in means} | {f"_{name}": there.copy() for name in now}
        return means | now | present
