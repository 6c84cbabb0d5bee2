"""Cases and tasks as plain data, for files and for hashes. A function counts by its values at fixed points."""

import dataclasses
import hashlib
import json
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from manywake.case.case import Case, readings
from manywake.case.sensors import integrals
from manywake.case.task import Task


def plain(value: Any) -> Any:
    """Return settings as what JSON can hold: data classes as their fields and kind, functions of angles as values."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
        return {"kind": type(value).__name__, **fields}
    if isinstance(value, Mapping):
        return {str(key): plain(part) for key, part in value.items()}
    if isinstance(value, tuple | list):
        return [plain(part) for part in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)  # which JSON has no number for
    if callable(value):
        angles = np.linspace(0.0, 2 * np.pi, 37)[:-1]
        return [[_digits(number) for number in point] for point in np.asarray(value(angles)).tolist()]
    return value


def case(chosen: Case) -> dict[str, Any]:
    """Return all that a case says."""
    data = plain(chosen)
    if not chosen.sizes.near:  # what has none keeps the hash that it had before there was any
        del data["sizes"]["near"]
    if chosen.mesh is None:
        del data["mesh"]
    else:
        del data["mesh"]["path"]  # it is the same mesh elsewhere
    return data


def task(chosen: Case, task: Task) -> dict[str, Any]:
    """Return all that a task says; its reward and its charge by their names and some values."""
    free = {name: 3.0 - 0.5 * k for k, name in enumerate(readings(chosen))}
    samples = [{name: math.sin(1.0 + k * (j + 2)) for j, name in enumerate(free)} for k in range(5)]
    rewards = [_value(task.reward, now, free) for now in samples]
    charges = [_value(task.charge, task.reward, samples[:count], free) for count in (1, 5)]
    reward, charge = {"name": _name(task.reward), "values": rewards}, {"name": _name(task.charge), "values": charges}
    return plain(vars(task) | {"reward": reward, "charge": charge})


def digest(data: Any) -> str:
    """Return a hash of plain data."""
    return hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()


def flow_digest(chosen: Case) -> str:
    """Return a hash of all that decides the baseline: the case but for probes and limits below the strengths."""
    data = case(chosen)
    del data["sensors"]
    if measured := integrals(chosen.sensors):  # the baseline has their statistics
        data["sensors"] = [{name: part for name, part in plain(s).items() if name != "noise"} for s in measured]
    for actuator, said in zip(chosen.actuators, data["actuators"], strict=True):
        said["strength"] = actuator.strongest
        del said["limit"]
    return digest(data | {"time_step": chosen.dt})


def geometry_digest(chosen: Case) -> str:
    """Return a hash of all that decides the mesh."""
    data = case(chosen)
    decides = {name: data[name] for name in ("domain", "bodies", "sizes", "mesh") if name in data}
    return digest(decides | {"length": chosen.scales.length})


def _name(function: Callable) -> str:
    return getattr(function, "__name__", type(function).__name__)


def _value(function: Callable, *of: Any) -> float | str:
    """Return a value to ten digits; the kind of its error where a function has none, as the root of a negative drag."""
    try:
        return _digits(function(*of))
    except (ArithmeticError, ValueError) as error:
        return type(error).__name__


def _digits(number: float) -> float:
    return float(f"{number:.10g}")
