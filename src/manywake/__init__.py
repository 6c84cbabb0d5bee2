"""Manywake: deep reinforcement learning of active flow control, on many simulations at once.

Rooms, each importing from those before it only: machine, case, flow, suite, env, plots, learn, export and movie, then
api, sb3 and play, then cli.
Importing this package registers `manywake/Flow-v0` and the shipped flows with Gymnasium. The words that a case file is
written in are all here: `from manywake import *`.

Axis letters: n velocity node, m pressure node, e element, q quadrature point, k local node, B flow, T action.
"""

from manywake import case as _case
from manywake.api import OpenRun, evaluate, judge, load_policy, load_run, resume, search, train
from manywake.case import *  # noqa: F403
from manywake.env import env as _env
from manywake.env.env import FlowEnv, FlowVectorEnv
from manywake.learn.settings import Collection
from manywake.suite.load import choose

_env.register()

__all__ = [
    *_case.__all__,
    "Collection", "FlowEnv", "FlowVectorEnv", "OpenRun", "choose", "evaluate",
    "judge", "load_policy", "load_run", "resume", "search", "train",
]  # fmt: skip
