"""Ours beside what others use: legacy FEniCS as written and tuned, scikit-fem with SciPy, and manywake's batches.

Run: manywake bench peers --json

One environment step of every contestant is a time step with its jets, pressure at 151 probes, drag and lift. The peers
step the paper's scheme at 5e-4 on 9241 triangles of the released code's sizes (benchmarks/peers); ours is the flow of
`make train`, whatever its mesh and time step are. Every measurement is a process of its own with one thread, one after
the other, in turns, so that a drift of the machine meets all of them. Time is the processor's, which neighbours disturb
less than the clock; the clock's is given beside it. Set-up is not counted: an episode is its steps' time. What is not
installed is said and left out. `ratio` is a quotient of medians over all turns, `ratio_by_turn` that within each turn.
"""

import json
import os
import platform
import statistics
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from manywake.cli.show import say

FOLDER = Path(__file__).with_suffix("")
EPISODE = 2.0
WIDTHS = (1, 8, 16, 32)
FEATFLOW = {"cd_mean": 3.1959, "cl_max": 0.9866, "strouhal": 0.3018}
"""Q2/P1 level 6, dt 1/1600."""
SYSTEM_PYTHON = "/usr/bin/python3"
PEERS = {
    "fenics as written": [SYSTEM_PYTHON, "fenics.py", "as-written"],
    "fenics tuned": [SYSTEM_PYTHON, "fenics.py", "tuned"],
    "scikit-fem": [sys.executable, "scikit.py"],
}
NEEDS = {SYSTEM_PYTHON: ("dolfin, petsc4py", "apt-get install python3-dolfin"), sys.executable: ("skfem", "scikit-fem")}
OURS = [sys.executable, "ours.py", *map(str, WIDTHS)]


def missing(python: str) -> str | None:
    """Return why the peers of this Python cannot run, or None."""
    modules, remedy = NEEDS[python]
    try:
        subprocess.run([python, "-c", f"import {modules}"], check=True, capture_output=True, timeout=300)
    except FileNotFoundError:
        return f"{python} is not there"
    except subprocess.CalledProcessError as error:
        return f"{error.stderr.decode().strip().splitlines()[-1]}; remedy: {remedy}"
    return None


def contest(command: list[str]) -> dict[str, Any]:
    """Run one contestant once; return what it printed last."""
    one = {f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL", "NUMBA")}
    # the checkout that this file is of, not one that happens to be installed
    path = str(FOLDER.parents[1] / "src")
    extra = {"PYTHONPATH": path} if command[0] != SYSTEM_PYTHON else {}
    done = subprocess.run(
        [command[0], str(FOLDER / command[1]), *command[2:]],
        env={**os.environ, **one, **extra},
        capture_output=True,
        text=True,
        timeout=1200,
    )
    if done.returncode:
        raise RuntimeError(f"{command[1]} failed:\n{done.stderr[-2000:]}")
    return json.loads(done.stdout.splitlines()[-1])


def figures(runs: list[dict[str, Any]], time_step: float) -> dict[str, Any]:
    """Return ms per flow and step (median and spread of blocks) and core-seconds per flow and episode."""
    cpu, wall = (sorted(x for run in runs for x in run[key]) for key in ("cpu_ms", "wall_ms"))
    steps = round(EPISODE / time_step)
    return {
        "ms_per_flow_step": statistics.median(cpu),
        "spread_ms": [cpu[0], cpu[-1]],
        "quartiles_ms": np.quantile(cpu, [0.25, 0.75]).tolist(),
        "wall_ms_per_flow_step": statistics.median(wall),
        "dt": time_step,
        "steps_per_episode": steps,
        "core_seconds_per_episode": statistics.median(cpu) * steps / 1e3,
    }


def errors(found: dict[str, float]) -> dict[str, Any]:
    """Return the statistics and their relative errors against FeatFlow."""
    return {
        "statistics": {name: found[name] for name in FEATFLOW},
        "error": {name: found[name] / wanted - 1.0 for name, wanted in FEATFLOW.items()},
    }


def measure(repeats: int = 5, steps: int = 60) -> dict[str, Any]:
    """Run what is installed in turn, `repeats` times, and return times, errors and ratios.

    steps: of a peer at each turn, after 20 to warm up. About half a minute a turn; the first also compiles.
    """
    commands = {name: [*command, "--steps", str(steps)] for name, command in PEERS.items()}
    reasons = {python: missing(python) for python in NEEDS}
    not_installed = {name: reasons[c[0]] for name, c in commands.items() if reasons[c[0]]}
    for name, why in not_installed.items():
        say(f"{name}: not installed: {why}")
        del commands[name]
    load = [os.getloadavg()[0]]
    runs: dict[str, list] = {name: [] for name in [*commands, "manywake"]}
    for turn in range(repeats):
        for name, command in [*commands.items(), ("manywake", OURS)]:
            runs[name].append(contest(command))
            last = runs[name][-1]
            timed = last["widths"] if name == "manywake" else {"": last}
            shown = [f"{w and f'B={w} '}{statistics.median(x['cpu_ms']):.3f}" for w, x in timed.items()]
            say(f"turn {turn + 1}/{repeats}, {name}: {', '.join(shown)} ms per flow and step")
    load.append(os.getloadavg()[0])

    ours = runs["manywake"][0]
    widths = {w: figures([run["widths"][w] for run in runs["manywake"]], ours["time_step"]) for w in map(str, WIDTHS)}
    seconds = {w: row["core_seconds_per_episode"] for w, row in widths.items()}
    best = min(seconds, key=seconds.__getitem__)
    recorded = json.loads((FOLDER / "statistics.json").read_text())
    peers: dict[str, Any] = {}
    for name in commands:
        first = runs[name][0]
        sizes = {key: first[key] for key in ("version", "triangles", "velocity_dofs", "pressure_dofs")}
        source = recorded["fenics" if name.startswith("fenics") else "scikit"]
        peers[name] = {
            **figures(runs[name], 5e-4),
            **sizes,
            **errors(source["statistics"]),
            "state_after": first["state_after"],
        }
    # same scheme, mesh and actions: what is compared is the same computation
    drags = [peer["state_after"]["c_d"] for peer in peers.values()]

    wanted = {
        "as_written": ("fenics as written", best),
        "tuned": ("fenics tuned", best),
        "single_flow": ("fenics as written", "1"),
        "scikit": ("scikit-fem", best),
        "scikit_single_flow": ("scikit-fem", "1"),
    }

    def ratio(peer: str, width: str) -> float | None:
        return peers[peer]["core_seconds_per_episode"] / seconds[width] if peer in peers else None

    def by_turn(peer: str, width: str) -> list[float]:
        pairs = zip(runs.get(peer, []), runs["manywake"], strict=peer in runs)
        each = [(figures([a], 5e-4), figures([b["widths"][width]], ours["time_step"])) for a, b in pairs]
        return [a["core_seconds_per_episode"] / b["core_seconds_per_episode"] for a, b in each]

    return {
        "machine": {"cpu": _cpu(), "cores": os.cpu_count(), "python": platform.python_version(), "load": load},
        "repeats": repeats,
        "not_installed": not_installed,
        "peers": peers,
        "largest_difference_of_c_d": max(drags) - min(drags) if drags else None,
        "manywake": {
            **{key: ours[key] for key in ("case", "scheme", "triangles", "velocity_dofs", "pressure_dofs")},
            "time_step": ours["time_step"],
            "widths": widths,
            "best_width": int(best),
            **errors(ours["statistics"]),
        },
        "ratio": {name: ratio(*who) for name, who in wanted.items()},
        "ratio_by_turn": {name: by_turn(*who) for name, who in wanted.items()},
    }


def _cpu() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), "unknown")
