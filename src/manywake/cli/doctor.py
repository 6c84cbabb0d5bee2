"""manywake doctor: what is here, and whether the solver does what it should. Leaves nothing but compiled kernels."""

import json
import platform
import re
import shutil
import tempfile
import time
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numpy as np
from platformdirs import user_cache_path

from manywake.cli import show
from manywake.cli.show import Json, console, say
from manywake.flow import store
from manywake.flow.batch import FlowBatch, recorded
from manywake.flow.store import Flow
from manywake.learn.collect import usable_cores
from manywake.machine import simd
from manywake.suite import load

NEEDED = ("numba", "llvmlite", "numpy", "scipy", "scikit-fem", "gymnasium", "stable-baselines3", "torch", "tyro")
"""Packages whose versions matter most when something is amiss."""
FOR_DEVELOPERS = ("dev", "docs")
"""Extras that no command needs."""
REGISTERS = {"avx512f": 512, "avx": 256}
"""Bits of the widest vector register of a processor with a feature; those of all others have 128."""
WITHIN = 1e-3
"""Share by which the drag of one shedding period may be off the baseline's mean."""
STEPS = 100
"""Steps that flows are advanced alone and in a batch."""
REMEDY = (
    "the solver does not do here what it should; install the versions of constraints.txt and empty the cache folder. "
    "If that does not help, report it with what manywake doctor --json prints"
)


@dataclass(frozen=True)
class Check:
    """One finding of the self-test: what was tried, what came out, what was wanted, whether that is it."""

    what: str
    got: str
    wanted: str
    passed: bool


@dataclass(frozen=True)
class Doctor:
    """Tell what is installed here, and test the solver on a shipped flow in a few seconds.

    Exit status 0 when the self-test passes, 1 when it does not. On first use kernels are compiled, half a minute more.
    """

    json: Json = False

    def run(self) -> int:
        about = surroundings()
        if not self.json:
            show.table([("", "found"), *((name, str(value)) for name, value in about.items())])
        started = time.perf_counter()
        with console.status("self-test; the first one compiles kernels"):
            checks = self_test()
        seconds, passed = time.perf_counter() - started, all(check.passed for check in checks)
        if self.json:
            tried = [asdict(check) for check in checks]
            print(json.dumps({**about, "self-test": tried, "seconds": round(seconds, 1), "passed": passed}))
        else:
            rows = [(c.what, c.got, c.wanted, "yes" if c.passed else "NO") for c in checks]
            show.table([("self-test", "got", "wanted", "passed"), *rows])
        for check in (check for check in checks if not check.passed):
            say(f"self-test: {check.what}: got {check.got}, wanted {check.wanted}")
        say(f"the solver works ({seconds:.0f} s)" if passed else REMEDY)
        return 0 if passed else 1


def surroundings() -> dict[str, Any]:
    """Return what is here, by name: versions, cores, vectors, folders, and the packages of the optional parts."""
    cache = user_cache_path("manywake")
    found: dict[str, Any] = {"manywake": _version("manywake"), "python": platform.python_version()}
    found |= {name: _version(name) for name in NEEDED}
    found |= {"system": platform.platform(), "cores": usable_cores()}
    found |= {"vector register [bits]": register(), "flows side by side": simd.WIDTHS[0]}
    found |= {"cache": str(cache), "cache writable": writable(cache)}
    found |= {"free for the cache [GB]": _free(cache), "free here [GB]": _free(Path.cwd())}
    return found | {f"extra {extra}": found_of(names) for extra, names in extras().items()}


def register() -> int:
    """Return the bits of the widest vector register that compiled kernels can use here."""
    features = llvm.get_host_cpu_features()
    return next((bits for feature, bits in REGISTERS.items() if features.get(feature)), 128)


def writable(folder: Path) -> bool:
    """Return whether files can be made in a folder, or, where it is not there yet, in the one that it would be in."""
    try:
        with tempfile.TemporaryFile(dir=_there(folder)):
            return True
    except OSError:
        return False


def extras() -> dict[str, list[str]]:
    """Return the packages that each optional part of manywake needs."""
    found: dict[str, list[str]] = {}
    for line in metadata.requires("manywake") or ():
        wanted = re.match(r"([\w.-]+).*extra == ['\"]([\w-]+)['\"]", line)
        if wanted and wanted[2] not in FOR_DEVELOPERS:
            found.setdefault(wanted[2], []).append(wanted[1])
    return found


def found_of(names: list[str]) -> str:
    """Return the versions of an optional part's packages, or what is amiss."""
    said = []
    for name in names:
        try:
            said.append(f"{name} {metadata.version(name)}")
            if name == "gmsh":
                import gmsh  # noqa: F401 - it needs libraries of the system
        except metadata.PackageNotFoundError:
            said.append(f"{name} not found")
        except (ImportError, OSError) as error:
            said[-1] += f", which cannot be loaded ({error})"
    return "; ".join(said)


def self_test() -> list[Check]:
    """Return what came out on the default case; what fails in between is a finding too."""
    try:
        flow = store.flow(load.load(load.DEFAULT).case)
        return [drag(flow), same(*beside(flow))]
    except Exception as error:  # whatever it is, it is what ails this machine
        return [Check("the shipped flow runs", f"{type(error).__name__}: {error}", "no error", False)]


def drag(flow: Flow) -> Check:
    """Compare the drag of one shedding period without control with the mean that the baseline has."""
    free = flow.baseline.statistics
    steps = round((free.period or flow.case.convective_time) / flow.case.dt)
    still = np.zeros((steps, len(flow.case.actuators), 1))
    ours = recorded(FlowBatch(flow.operators, flow.baseline.start, 1), still, _quiet, "")["c_d"].mean()
    wanted = free.readings["c_d"].mean
    passed = abs(ours / wanted - 1) <= WITHIN
    return Check("mean C_D of a shedding period", f"{ours:.4f}", f"{wanted:.4f} within {WITHIN:.1%}", bool(passed))


def beside(flow: Flow) -> tuple[np.ndarray, np.ndarray]:
    """Return the readings (steps, functionals) of one flow under its jets: alone, and among others in a batch."""
    flows, mine = simd.WIDTHS[0], 2
    limits = np.array([actuator.limit for actuator in flow.case.actuators])
    driven = np.tile(limits[:, None] * np.linspace(-1.0, 1.0, flows), (STEPS, 1, 1))
    read = FlowBatch(flow.operators, flow.baseline.start, flows).advance(driven)[:, :, mine]
    alone = FlowBatch(flow.operators, flow.baseline.start, 1).advance(driven[:, :, mine : mine + 1])[:, :, 0]
    return alone, read


def same(alone: np.ndarray, among: np.ndarray) -> Check:
    """Compare the readings of one flow alone and in a batch, to the bit."""
    differ = int((alone != among).any(axis=1).sum())
    got = "the same bits" if not differ else f"other bits in {differ} of {len(alone)} steps"
    return Check("a flow alone and in a batch", got, "the same bits", differ == 0)


def _quiet(what: str, share: float) -> None:
    """Tell nothing of how far it is."""


def _there(folder: Path) -> Path:
    return next(path for path in (folder, *folder.parents) if path.exists())


def _free(folder: Path) -> float:
    return round(shutil.disk_usage(_there(folder)).free / 1e9, 1)


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "not found"
