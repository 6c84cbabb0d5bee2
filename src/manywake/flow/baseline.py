"""What every run starts from: mesh, start state, time-mean flow, uncontrolled statistics. Shipped, cached or made."""

import json
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields
from importlib.resources import files
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from filelock import FileLock
from platformdirs import user_cache_path

from manywake.flow import disk, operators, sensors, steady
from manywake.flow import mesh as meshes
from manywake.flow import space as spaces
from manywake.flow.batch import FlowBatch, Start
from manywake.flow.case import CASES, Case
from manywake.flow.mesh import Mesh
from manywake.flow.operators import Operators
from manywake.flow.sensors import Shedding

FORMAT = 1
MEAN_PERIODS = 12
SETTLE = 4.0
"""Time for which a street goes on once it is advected with its mean."""
_CHUNK = 50
_SAMPLE = 10
_RECENT = 2.0
"""Time over which the spin-up knows its own C_L: about six shedding periods."""

Progress = Callable[[str, float], None]
"""progress(what, share done): called now and then by work that takes long."""


@dataclass(frozen=True)
class Baseline:
    """The uncontrolled flow of one case.

    start: the developed Karman street at an upward crossing of C_L. mean: (n, 2) velocity averaged over whole periods,
    with which `Scheme.mean` advects. shedding: its statistics. cd_steady, cl_steady: C_D and C_L of the steady base
    flow, the drag that remains with all shedding gone. All fields are in scikit-fem's order.
    """

    flow_digest: str
    mesh: Mesh
    start: Start
    mean: np.ndarray
    shedding: Shedding
    cd_steady: float
    cl_steady: float
    recipe: str

    def arrays(self) -> dict[str, np.ndarray]:
        """Return everything but the description as named arrays."""
        named = {f"start_{f.name}": getattr(self.start, f.name) for f in fields(Start)}
        named |= {f"boundary_{name}": facets.astype(np.int32) for name, facets in self.mesh.boundaries.items()}
        return named | {
            "points": self.mesh.points,
            "triangles": self.mesh.triangles.astype(np.int32),
            "mean": self.mean,
        }

    def numbers(self) -> dict[str, Any]:
        """Return everything that is no array, as plain data."""
        return {
            "flow_digest": self.flow_digest,
            "shedding": asdict(self.shedding),
            "cd_steady": self.cd_steady,
            "cl_steady": self.cl_steady,
            "recipe": self.recipe,
        }

    def digest(self) -> str:
        """Return the hash of the content: two baselines with the same digest start every run from the same bits."""
        numbers = json.dumps(self.numbers(), sort_keys=True).encode()
        return disk.digest(self.arrays() | {"numbers": np.frombuffer(numbers, np.uint8)})


def make(case: Case, mesh: Mesh | None = None, progress: Progress | None = None) -> Baseline:
    """Compute the baseline of a case: mesh it (unless given), solve for the steady flow, spin up, and average.

    A scheme that advects with the mean flow has the steady flow in its place until there is a street to average.
    """
    report = progress or (lambda what, share: None)
    report("mesh", 0.0)
    mesh = meshes.build(case) if mesh is None else mesh
    report("steady flow", 0.0)
    base = steady.solve(case, spaces.build(mesh))
    ops = operators.assemble(case, mesh, base.u)
    flow = FlowBatch(ops, kicked(ops), 1)
    c_l = _develop(flow, case.spin_up, report, "spin-up")
    recipe = f"format {FORMAT}; kicked rest, over {case.spin_up:g} in steps of {case.time_step:g} ({case.scheme.name})"
    advecting = None
    if case.scheme.mean:
        advecting, _ = _average(flow, c_l, report, "mean flow")
        flow = FlowBatch(operators.assemble(case, mesh, advecting), flow.state(0), 1)
        c_l = _develop(flow, SETTLE, report, "spin-up about the mean")
        recipe += f" about the steady flow, mean over {MEAN_PERIODS} periods, over {SETTLE:g} more about that mean"
    _to_crossing(flow, c_l)
    start = flow.state(0)
    mean, record = _average(flow, c_l, report, "mean flow" if advecting is None else "statistics")
    recipe += f", stopped at an upward crossing of C_L; means sample every {_SAMPLE}th step; steady flow by Newton"
    return Baseline(
        case.flow_digest(),
        mesh,
        start,
        mean if advecting is None else advecting,
        sensors.shedding(record[:, 0], record[:, 1], case.time_step),
        base.c_d,
        base.c_l,
        recipe,
    )


def _develop(flow: FlowBatch, duration: float, report: Progress, what: str) -> np.ndarray:
    """Advance an uncontrolled flow; return its C_L over the last `_RECENT`."""
    time_step = flow.ops.case.time_step
    steps = int(round(duration / time_step))
    done, c_l = 0, np.zeros(0)
    while done < steps:
        c_l = np.concatenate([c_l, _run(flow, _CHUNK)[:, 1]])[-int(_RECENT / time_step) :]
        done += _CHUNK
        report(what, min(done / steps, 1.0))
    return c_l


def _to_crossing(flow: FlowBatch, c_l: np.ndarray) -> None:
    """Advance to the next upward crossing of the middle of C_L, step by step: a state of defined phase."""
    level = 0.5 * (c_l.max() + c_l.min())
    previous = c_l[-1]
    for _ in range(int(5 * _RECENT / flow.ops.case.time_step)):
        now = _run(flow, 1)[0, 1]
        if previous < level <= now:
            return
        previous = now
    name = flow.ops.case.name
    raise RuntimeError(f"baseline: C_L of case {name!r} does not oscillate; is the flow steady at this Re?")


def _average(flow: FlowBatch, c_l: np.ndarray, report: Progress, what: str) -> tuple[np.ndarray, np.ndarray]:
    """Advance over MEAN_PERIODS; return the mean velocity (n, 2), and C_D and C_L (steps, 2) of a little more."""
    time_step = flow.ops.case.time_step
    period = sensors.shedding(c_l, c_l, time_step).period
    wanted = int(round(MEAN_PERIODS * period / time_step / _SAMPLE)) * _SAMPLE
    total, samples, series = np.zeros((len(flow.ops.velocity_order), 2)), 0, []
    for k in range(0, wanted + 2 * _SAMPLE, _SAMPLE):
        series.append(_run(flow, _SAMPLE))
        if k < wanted:
            total += flow.state(0).u
            samples += 1
        report(what, min(k / wanted, 1.0))
    return total / samples, np.concatenate(series)


def _run(flow: FlowBatch, steps: int) -> np.ndarray:
    """Advance a single uncontrolled flow; return (steps, 2) C_D and C_L."""
    return flow.advance(np.zeros((steps, len(flow.ops.case.jets), 1)))[:, :, 0]


def kicked(ops: Operators) -> Start:
    """Return fluid at rest but for an upward gust behind the cylinder, so that shedding sets in at once."""
    x, y = ops.space.x.T
    n, m = len(x), ops.space.pressure_stiffness.shape[0]
    u = np.zeros((n, 2))
    u[:, 1] = 0.3 * np.exp(-((x - 0.15) ** 2 + y**2) / 0.05**2)
    u[ops.velocity_order[ops.free :]] = 0.0
    return Start(u, u.copy(), np.zeros(m), np.zeros(m), np.zeros(m))


def phases(ops: Operators, baseline: Baseline, count: int) -> list[Start]:
    """Return `count` states of the uncontrolled flow, spread evenly over one shedding period from the start state."""
    flow = FlowBatch(ops, baseline.start, 1)
    period = baseline.shedding.period / ops.case.time_step
    states, done = [], 0
    for k in range(count):
        wanted = int(round(k * period / count))
        if wanted > done:
            _run(flow, wanted - done)
            done = wanted
        states.append(flow.state(0))
    return states


def save(baseline: Baseline, path: Path) -> None:
    """Write a baseline atomically: either the whole file is there or none."""
    description = baseline.numbers() | {"digest": baseline.digest()}
    named: dict[str, Any] = {"description": np.array(json.dumps(description)), **baseline.arrays()}
    disk.write(path, lambda file: np.savez_compressed(file, **named))


def load(path: Path, case: Case | None = None) -> Baseline:
    """Read a baseline; ValueError when the file is damaged, is not what its hash says, or is of another flow."""
    try:
        baseline, digest = _read(path)
    except (zipfile.BadZipFile, zlib.error, EOFError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"baseline: {path} is damaged ({error}); delete the file and run again") from error
    if baseline.digest() != digest:
        raise ValueError(f"baseline: the content of {path} does not match its hash; delete the file and run again")
    if case is not None and baseline.flow_digest != case.flow_digest():
        raise ValueError(
            f"baseline: {path} is of another flow than case {case.name!r} has today; "
            "make it anew with: manywake baseline --make FILE"
        )
    return baseline


def _read(path: Path) -> tuple[Baseline, str]:
    with open(path, "rb") as file, np.load(file, allow_pickle=False) as data:
        description = json.loads(str(data["description"]))
        boundaries = {
            key.removeprefix("boundary_"): data[key].astype(np.int64) for key in data.files if key.startswith("bound")
        }
        baseline = Baseline(
            description["flow_digest"],
            Mesh(data["points"], data["triangles"].astype(np.int64), boundaries),
            Start(**{f.name: data[f"start_{f.name}"] for f in fields(Start)}),
            data["mean"],
            Shedding(**description["shedding"]),
            description["cd_steady"],
            description["cl_steady"],
            description["recipe"],
        )
    return baseline, description["digest"]


def shipped_path(case: Case) -> Path:
    """Return where the package keeps the baseline of a case of this name."""
    return Path(str(files("manywake") / "data" / f"{case.name}.npz"))


def cache_path(case: Case) -> Path:
    """Return where the user's cache keeps the baseline of this case."""
    return user_cache_path("manywake") / "baselines" / f"{FORMAT}-{case.flow_digest()[:32]}.npz"


def get(case: Case, progress: Progress | None = None) -> Baseline:
    """Return the baseline of a case: the shipped one, else the cached one, else one made now and cached.

    Safe when two processes want it at once: one makes it, the other waits and reads it. A geometry that a shipped
    case has already is not meshed again.
    """
    for name in CASES:
        path = shipped_path(CASES[name])
        if CASES[name].flow_digest() == case.flow_digest() and path.exists():
            return load(path, case)
    path = cache_path(case)
    if path.exists():
        return load(path, case)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        held = FileLock(str(path) + ".lock").acquire()
    except OSError as error:
        raise RuntimeError(
            f"cache: cannot write {path.parent} ({error}); wanted a folder to keep the start state of case "
            f"{case.name!r} in; make it writable or set XDG_CACHE_HOME to one that is"
        ) from error
    with held:
        if not path.exists():
            save(make(case, _shipped_mesh(case), progress), path)
    return load(path, case)


def _shipped_mesh(case: Case) -> Mesh | None:
    def geometry(c: Case) -> tuple:
        return c.jets, c.resolution, c.radius, c.x_range, c.y_range

    for other in CASES.values():
        if geometry(other) == geometry(case) and shipped_path(other).exists():
            return load(shipped_path(other)).mesh
    return None


_assembled: dict[Case, tuple[Operators, Baseline]] = {}
_assembling = Lock()


def assembled(case: Case, progress: Progress | None = None) -> tuple[Operators, Baseline]:
    """Return the operators and the baseline of a case, made once and kept for the life of the process."""
    with _assembling:
        if case not in _assembled:
            base = get(case, progress)
            _assembled[case] = operators.assemble(case, base.mesh, base.mean), base
        return _assembled[case]
