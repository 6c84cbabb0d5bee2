"""Operators in a file, so that a run can go on with these very bits on any machine."""

from pathlib import Path
from typing import Any, get_type_hints

import numpy as np

from manywake.flow.factors import Rows
from manywake.flow.mesh import Mesh
from manywake.flow.operators import Operators, Tables, flatten
from manywake.machine import disk

_PLAIN = ("velocity_order", "pressure_order", "kinetic", "noise")
_NAMES = ("inputs", "functionals")


def arrays(ops: Operators) -> dict[str, np.ndarray]:
    """Return every array of the operators by its dotted name."""
    named = flatten("tables", ops.tables) | {name: getattr(ops, name) for name in _PLAIN}
    for name, (_, rows) in ops.sensors.items():
        named |= flatten(f"sensor:{name}", rows)
    return named


def save(ops: Operators, path: Path) -> None:
    """Write operators, whole or not at all."""
    about = {name: getattr(ops, name) for name in ("digest", "free", "time_step", *_NAMES)}
    about["sensors"] = {name: field for name, (field, _) in ops.sensors.items()}
    named = disk.packed(about, arrays(ops))
    disk.write(path, lambda file: np.savez(file, **named))


def load(path: Path, mesh: Mesh) -> Operators:
    """Read operators on a mesh; ValueError when the file is damaged or of another version."""
    try:
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as data:
            about = disk.description(data)
            named = {name: data[name] for name in _PLAIN} | {name: tuple(about[name]) for name in _NAMES}
            sensors = {name: (of, _gather(f"sensor:{name}", Rows, data)) for name, of in about["sensors"].items()}
            tables, free, time_step = _gather("tables", Tables, data), about["free"], about["time_step"]
            ops = Operators(mesh, tables, free=free, time_step=time_step, sensors=sensors, **named)
            whole = ops.digest == about["digest"]
    except disk.DAMAGE as error:
        raise ValueError(f"operators: {path} is damaged or of another version ({error})") from error
    if not whole:
        raise ValueError(f"operators: the content of {path} does not match its hash")
    return ops


def _gather(name: str, kind, arrays) -> Any:
    """Undo `flatten`, into named tuples of type `kind`."""
    if kind is np.ndarray:
        return arrays[name]
    return kind(*(_gather(f"{name}.{child}", of, arrays) for child, of in get_type_hints(kind).items()))
