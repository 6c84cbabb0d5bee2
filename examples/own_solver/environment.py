"""A Gymnasium environment whose flow is computed by a program of its own, spoken to in JSON lines.

The program is started by the first reset, so that a look at the spaces costs nothing. It is ended by `close`, when the
environment is collected as garbage, at the end of Python, and by its own standard input, which closes whichever way the
process above it goes. One that dies or does not answer in time is ended, the step or reset raises `SolverLost`, and the
next reset starts a new one. It is not started anew in mid-episode: the state is gone with it, and an episode that went
on from another one would not be a function of its seed. So manywake's collector plays the whole episode again, from the
same seed to the same bits.
"""

import json
import os
import selectors
import signal
import subprocess
import sys
import time
import weakref
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box

COMMAND = (sys.executable, str(Path(__file__).with_name("solver.py")))
CD_UNCONTROLLED = 3.195
LIFT_WEIGHT = 0.2
READINGS = {"probes", "c_d", "c_l"}


class SolverLost(RuntimeError):
    """The solver died, did not answer in time, or answered what makes no sense."""


class Solver:
    """A program that answers every line with a line.

    It has a session of its own: Ctrl-C in the terminal does not reach it, and it is ended with all that it started, as
    the ranks of an MPI program are.
    """

    def __init__(self, command: tuple[str, ...]):
        pipe = subprocess.PIPE
        try:
            self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, bufsize=0, start_new_session=True)
        except OSError as error:
            raise SolverLost(
                f"solver: got {error}, wanted a program that starts; check the command {command}"
            ) from error
        self._selector = selectors.DefaultSelector()
        assert self._process.stdout is not None
        self._selector.register(self._process.stdout, selectors.EVENT_READ)
        self.pid = self._process.pid
        self.close = weakref.finalize(self, _end, self._process, self._selector)

    def ask(self, wish: dict[str, Any], seconds: float) -> dict[str, Any]:
        """Send a line and return the answer; SolverLost when there is none within `seconds`."""
        process = self._process
        assert process.stdin is not None and process.stdout is not None
        deadline, answer = time.monotonic() + seconds, b""
        try:
            process.stdin.write(json.dumps(wish).encode() + b"\n")
        except BrokenPipeError:
            pass  # it has died; reading tells how
        while not answer.endswith(b"\n"):
            if not self._selector.select(max(deadline - time.monotonic(), 0.0)):
                raise SolverLost(
                    f"solver {self.pid}: got no answer to {wish} within {seconds:g} s, wanted a line; reset starts it "
                    "anew; give a slow solver a longer `seconds`"
                )
            piece = os.read(process.stdout.fileno(), 1 << 16)
            if not piece:
                raise SolverLost(
                    f"solver {self.pid}: got its end ({_how(process)}) in answer to {wish}, wanted a line; reset "
                    "starts it anew; its last words are on the standard error"
                )
            answer += piece
        try:
            found = json.loads(answer)
        except ValueError:
            found = {"error": f"{answer[:200]!r} is no JSON"}
        if not isinstance(found, dict) or not READINGS <= found.keys():
            raise SolverLost(
                f"solver {self.pid}: got {found} in answer to {wish}, wanted {', '.join(sorted(READINGS))}; see the "
                "protocol in solver.py"
            )
        return found


def _how(process: subprocess.Popen) -> str:
    try:
        code = process.wait(1)
    except subprocess.TimeoutExpired:
        return "it closed its output"
    return f"signal {-code}" if code < 0 else f"exit code {code}"


def _end(process: subprocess.Popen, selector: selectors.BaseSelector) -> None:
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except ProcessLookupError:
        pass  # it was reaped
    process.wait()
    selector.close()
    for pipe in (process.stdin, process.stdout):
        assert pipe is not None
        pipe.close()


class Wake(gymnasium.Env):
    """The wake of `solver.py`, to be calmed.

    Observation (4,): probes in the wake, of the order of 1. Action (1,) in [-1, 1]: the jet's flow rate, held for an
    action interval. Reward: C_D0 - C_D - 0.2 |C_L|. `info` has c_d and c_l. An episode has no end
    of its own. seconds: the longest that an answer may take; the first waits for the program's start too.
    """

    metadata = {"render_modes": []}

    def __init__(self, command: tuple[str, ...] = COMMAND, seconds: float = 30.0):
        self.command, self.seconds = command, seconds
        self.observation_space = Box(-10.0, 10.0, (4,), np.float32)
        self.action_space = Box(-1.0, 1.0, (1,), np.float32)
        self.solver: Solver | None = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        """Start an episode, and the solver if there is none."""
        super().reset(seed=seed, options=options)
        if self.solver is None:
            self.solver = Solver(self.command)
        observation, _, info = self._ask({"do": "reset", "seed": int(self.np_random.integers(2**31))})
        return observation, info

    def step(self, action):
        """Hold the action for one action interval."""
        if self.solver is None:
            raise SolverLost("step: got no solver, wanted one that was reset; call reset first")
        observation, reward, info = self._ask({"do": "step", "jet": float(np.clip(action[0], -1.0, 1.0))})
        return observation, reward, False, False, info

    def close(self) -> None:
        """End the solver."""
        if self.solver is not None:
            self.solver.close()
            self.solver = None

    def _ask(self, wish: dict[str, Any]) -> tuple[np.ndarray, float, dict[str, float]]:
        assert self.solver is not None
        try:
            answer = self.solver.ask(wish, self.seconds)
        except (
            BaseException
        ):  # also when stopped by Ctrl-C: an answer that is still to come would be taken for the next
            self.close()
            raise
        c_d, c_l = answer["c_d"], answer["c_l"]
        reward = CD_UNCONTROLLED - c_d - LIFT_WEIGHT * abs(c_l)
        return np.array(answer["probes"], np.float32), reward, {"c_d": c_d, "c_l": c_l}


def make() -> Wake:
    """Return the environment: manywake train --env environment:make."""
    return Wake()
