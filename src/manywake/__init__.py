"""Manywake: deep reinforcement learning of active flow control, on many simulations at once.

Reading order: flow (case, disk, simd, kernels, mesh, space, operators, steady, stepper, sensors, batch, baseline,
exact, validate), env (task, env), learn (policy, rollout, external, schedule, engine, ray_engine, collect, settings,
ppo, runs, train, evaluate), plots, cli.
Importing this package registers `manywake/CylinderJets-v0` with Gymnasium.

Axis letters: n velocity node, m pressure node, e element, q quadrature point, k local node, B flow, T action.
"""

from manywake.env import env as _env
from manywake.env.env import CylinderJetsEnv, CylinderJetsVectorEnv
from manywake.env.task import Task
from manywake.flow.case import Case, Jet, Resolution

_env.register()

__all__ = ["Case", "CylinderJetsEnv", "CylinderJetsVectorEnv", "Jet", "Resolution", "Task"]
