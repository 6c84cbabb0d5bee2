"""The door of a task: one that does not fit its case is refused before anything is meshed."""

import math
from dataclasses import replace

import numpy as np

from manywake.case import task as tasks
from manywake.case.case import Case, readings
from manywake.case.sensors import Probes
from manywake.case.task import Task


def check(case: Case, task: Task) -> None:
    """Raise ValueError where a task does not fit its case."""
    for reynolds in task.reynolds_numbers:
        task.steps(replace(case, reynolds=reynolds).dt)
    task.steps(case.dt)
    if not case.actuators:
        raise ValueError("actuators: got none, wanted at least one that the agent drives, as Jet or Rotation")
    mixing = tasks.matrix(task, len(case.actuators))
    probes = [sensor.name for sensor in case.sensors if isinstance(sensor, Probes)]
    known = (*probes, *readings(case), "amplitudes")
    for sensor in case.sensors:
        if known.count(sensor.name) > 1:
            raise ValueError(f"sensor {sensor.name!r}: got the name of a reading, wanted another")
    if isinstance(task.observe, str):
        raise ValueError(f"observe: got {task.observe!r}, wanted a tuple of names, as ({task.observe!r},)")
    for name in task.observe:
        if name not in known:
            raise ValueError(f"observe: got {name!r}, wanted some of {', '.join(known)}")
    if not task.observe:
        raise ValueError(f"observe: got nothing, wanted some of {', '.join(known)}")
    net = np.array([(actuator.flux or 0.0) * actuator.limit for actuator in case.actuators]) @ mixing
    if not case.outlet and abs(net).max() > 1e-12:
        raise ValueError(
            f"mixing: got a net flux of up to {abs(net).max():g}, wanted none, as no boundary has an Outflow to let it "
            "out; let what one jet blows in be sucked out by others (PAIR, pairs, balanced)"
        )
    _try_reward(case, task)


def _try_reward(case: Case, task: Task) -> None:
    if not callable(task.reward):
        raise ValueError(f"reward: got {task.reward!r}, wanted a function reward(now, free)")
    free = dict.fromkeys(readings(case), 1.0)
    now = {reading: 0.1 * (k + 1) for k, reading in enumerate(free)}
    tried = {"reward": lambda: task.reward(now, free), "charge": lambda: task.charge(task.reward, [now], free)}
    for what, call in tried.items():
        name = getattr(getattr(task, what), "__name__", what)
        try:
            got = call()
        except KeyError as error:
            raise ValueError(
                f"{what}: {name} asks for {error.args[0]!r}, wanted readings of this case: {', '.join(free)}"
            ) from error
        except Exception as error:
            tried_on = ", ".join(f"{reading} = {value:g}" for reading, value in now.items())
            where = f"tried on {tried_on}" if what == "reward" else "it calls the reward on readings of its own"
            raise ValueError(
                f"{what}: {name} fails on finite readings ({type(error).__name__}: {error}); {where}"
            ) from error
        if isinstance(got, bool) or not isinstance(got, (int, float)) or not math.isfinite(got):
            raise ValueError(f"{what}: {name} returned {got!r}, wanted a finite number")
