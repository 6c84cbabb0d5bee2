"""Operators in a file, so that a run can go on with these very bits on any machine."""

import json
import zipfile
import zlib
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np

from manywake.flow.factors import Rows
from manywake.flow.mesh import Mesh
from manywake.flow.operators import Operators, Tables, flatten
from manywake.machine import disk

_PLAIN = ("velocity_order", "pressure_order", "kinetic")


def arrays(ops: Operators) -> dict[str, np.ndarray]:
    """Return every array of the operators by its dotted name."""
    named = flatten("tables", ops.tables) | {name: getattr(ops, name) for name in _PLAIN}
    for name, (_, rows) in ops.sensors.items():
        named |= flatten(f"sensor:{name}", rows)
    return named


def save(ops: Operators, path: Path) -> None:
    """Write operators, whole or not at all."""
    description = {
        "digest": ops.digest,
        "free": ops.free,
        "time_step": ops.time_step,
        "inputs": ops.inputs,
        "functionals": ops.functionals,
        "sensors": {name: field for name, (field, _) in ops.sensors.items()},
    }
    named: dict[str, Any] = {"description": np.array(json.dumps(description)), **arrays(ops)}
    disk.write(path, lambda file: np.savez(file, **named))


def load(path: Path, mesh: Mesh) -> Operators:
    """Read operators on a mesh; ValueError when the file is damaged or of another version."""
    try:
        with np.load(path, allow_pickle=False) as data:
            about = json.loads(str(data["description"]))
            ops = Operators(
                mesh,
                _gather("tables", Tables, data),
                free=about["free"],
                time_step=about["time_step"],
                inputs=tuple(about["inputs"]),
                functionals=tuple(about["functionals"]),
                sensors={
                    name: (field, _gather(f"sensor:{name}", Rows, data)) for name, field in about["sensors"].items()
                },
                **{name: data[name] for name in _PLAIN},
            )
            whole = ops.digest == about["digest"]
    except (OSError, zipfile.BadZipFile, zlib.error, EOFError, KeyError, ValueError) as error:
        raise ValueError(f"operators: {path} is damaged or of another version ({error})") from error
    if not whole:
        raise ValueError(f"operators: the content of {path} does not match its hash")
    return ops


def _gather(name: str, kind, arrays) -> Any:
    """Return the nested named tuples of type `kind` from their arrays, as `flatten` names them."""
    if kind is np.ndarray:
        return arrays[name]
    return kind(*(_gather(f"{name}.{child}", of, arrays) for child, of in get_type_hints(kind).items()))
