"""Flows ready to run: their baselines are shipped, cached, or made and cached; their operators assembled."""

from collections import OrderedDict
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from threading import Lock

from filelock import FileLock
from platformdirs import user_cache_path

from manywake.case import describe
from manywake.case.case import Case
from manywake.flow import baseline, problem
from manywake.flow import mesh as meshes
from manywake.flow.baseline import FORMAT, Baseline, Progress
from manywake.flow.batch import Start
from manywake.flow.mesh import Mesh
from manywake.flow.operators import Operators

KEPT = 2
"""Assembled flows that a process keeps, the ones used last."""


@dataclass(frozen=True)
class Flow:
    """A flow that can be advanced: what it is, its operators, and what it starts from."""

    case: Case
    operators: Operators
    baseline: Baseline

    @cached_property
    def starts(self) -> tuple[Start, ...]:
        """States that an episode can start from, far apart; the first is the start state."""
        base = self.baseline
        return tuple(baseline.spread(self.operators, base.starts, base.statistics.period))


def shipped() -> list[Path]:
    """Return the baselines that the package keeps."""
    return sorted(Path(str(files("manywake") / "suite")).glob("*.npz"))


def cache_path(case: Case) -> Path:
    """Return where the user's cache keeps the baseline of this case."""
    return user_cache_path("manywake") / "baselines" / f"{FORMAT}-{describe.flow_digest(case)[:32]}.npz"


def get(case: Case, progress: Progress | None = None) -> Baseline:
    """Return the baseline of a case: the shipped one, else the cached one, else one made now and cached.

    Of two processes that want it at once one makes it, the other waits and reads it. A geometry that a shipped case has
    is not meshed again.
    """
    wanted = describe.flow_digest(case)
    for path in shipped():
        if baseline.description(path).get("flow_digest") == wanted:
            return baseline.load(path, case)
    path = cache_path(case)
    if path.exists():
        return baseline.load(path, case)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        held = FileLock(str(path) + ".lock").acquire()
    except OSError as error:
        raise RuntimeError(
            f"cache: cannot write {path.parent} ({error}); wanted a folder to keep the start state of this case in; "
            "make it writable or set XDG_CACHE_HOME to one that is"
        ) from error
    with held:
        if not path.exists():
            baseline.save(baseline.make(case, _mesh(case), progress), path)
    return baseline.load(path, case)


def mesh(case: Case) -> Mesh:
    """Return a case's mesh: that of a baseline on its geometry, shipped or cached, else one that is made now."""
    return _mesh(case) or meshes.build(case)


def _mesh(case: Case) -> Mesh | None:
    """Return a mesh of the case's geometry from the shipped baselines, or from those in the cache."""
    wanted = describe.geometry_digest(case)
    for path in (*shipped(), *cache_path(case).parent.glob(f"{FORMAT}-*.npz")):
        if baseline.description(path).get("geometry_digest") == wanted:
            return baseline.read(path, case).mesh
    return None


_flows: OrderedDict[str, Flow] = OrderedDict()
_assembling = Lock()


def flow(case: Case, progress: Progress | None = None) -> Flow:
    """Return a case's flow; the last `KEPT` of them stay assembled."""
    key = describe.digest(describe.case(case))
    with _assembling:
        if key not in _flows:
            base = get(case, progress)
            _flows[key] = Flow(case, baseline.assemble(case, problem.pose(case, base.mesh), *base.advecting), base)
            while len(_flows) > KEPT:
                _flows.popitem(last=False)
        _flows.move_to_end(key)
        return _flows[key]
