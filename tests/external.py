"""What is not ours: environments, a point to be pushed back to zero and one that fails, a user's case file, a trap."""

import os
from pathlib import Path

import gymnasium
import numpy as np
from gymnasium.spaces import Box

CASE = """
from pathlib import Path

from manywake.suite.cylinder_jets import *

Path(__file__).with_name("marker").touch()  # tells that this file was run
WEIGHT = 0.25
CASE = replace(CASE, sensors=(Pressure("pressure", ((0.1, 0.0), (0.2, 0.05))),))


def saved(now, free):
    return free["c_d"] - now["c_d"]


def own(now, free):
    return WEIGHT * saved(now, free)


TASK = replace(TASK, actions=2, reward=own)
"""


def case_file(folder: Path) -> Path:
    """Write a user's case file: the default case with two probes and a reward of its own."""
    path = folder / "mine.py"
    path.write_text(CASE)
    return path


class Trap:
    """Unpickled, it makes a folder."""

    def __init__(self, path: Path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


class Point(gymnasium.Env):
    observation_space = Box(-10, 10, (2, 1), np.float32)
    action_space = Box(-2, 2, (1,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x = self.np_random.uniform(-1, 1)
        return self._observe(), {}

    def step(self, action):
        assert action.shape == (1,) and abs(action[0]) <= 2
        self.x += 0.1 + 0.5 * float(action[0])
        return self._observe(), -abs(self.x), abs(self.x) > 3, False, {"distance": abs(self.x), "note": "text"}

    def _observe(self):
        return np.array([[self.x], [1.0]], np.float32)


class Broken(Point):
    def step(self, action):
        raise ArithmeticError("out of order")


def make():
    return Point()


def broken():
    return Broken()
