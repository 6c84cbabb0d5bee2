"""A page for each shipped flow, made of its case file, its baseline, and what `manywake validate` found.

`validated/NAME.json` has what `manywake validate --case NAME --json` printed, rounded. Of channel, wide-cylinder,
pinball-deng, cylinder-jets-goda and step, which take long, it has rows of docs/validation.md instead.
"""

import ast
import inspect
import json
import math
import re
import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import gymnasium
from gymnasium.spaces import Box

from manywake.case import task as tasks
from manywake.case.case import Case
from manywake.case.inputs import BodyForce, Gust, Input, Jet, Noise, Rotation
from manywake.case.laws import Exponential, Held, Law
from manywake.case.sensors import Energy, Probes, Sensor, Shear, values
from manywake.case.task import Task
from manywake.env.control import spaces
from manywake.flow import store
from manywake.flow.baseline import Baseline
from manywake.suite import load
from manywake.suite.load import Definition

ROOT = Path(__file__).parents[1]
VALIDATED = Path(__file__).parent / "validated"
MEDIA = ROOT / "docs" / "flows"
CONTROLLERS = ROOT / "docs" / "controllers.md"


def index() -> str:
    """Return the page that lists all flows."""
    tasked, plain = [], []
    for name in load.names():
        definition = load.load(name)
        line = _summary(definition)
        (plain if definition.task is None else tasked).append(f"- [`{name}`]({name}.md): {line}")
    return "\n".join(
        [
            "# Flows",
            "",
            "Each flow is one short file. Its page says what is controlled, what is seen, what is rewarded, and how far"
            " the solver is from the numbers of others. To write your own, see [own flow](../own-flow.md).",
            "",
            "## Flows to control",
            "",
            *tasked,
            "",
            "## Flows that prove the solver",
            "",
            "They have no task. `manywake validate --case NAME` compares them with published numbers.",
            "",
            *plain,
            "",
        ]
    )


def page(name: str) -> str:
    """Return the page of a shipped flow."""
    definition = load.load(name)
    base = store.get(definition.case)
    parts = [f"# {name}", "", *_opening(definition), *_shown(name)]
    parts += _facts(definition.case, base)
    if definition.task is not None:
        parts += [*_use(definition), *_controlled(definition.case, definition.task)]
        parts += [*_observed(definition.case, definition.task), *_rewarded(definition), *_episode(definition, base)]
    parts += [*_references(name), *_compared(definition)]
    return "\n".join(parts) + "\n"


def _said(definition: Definition) -> list[str]:
    """Return the paragraphs of the case file's own words."""
    said = ast.get_docstring(ast.parse(definition.content)) or ""
    return [" ".join(part.split()) for part in said.split("\n\n")]


def _summary(definition: Definition) -> str:
    return _said(definition)[0]


def _opening(definition: Definition) -> list[str]:
    return [line for part in _said(definition) for line in (part, "")]


def _shown(name: str) -> list[str]:
    """Return picture and film, where there are any."""
    film, picture = MEDIA / f"{name}.mp4", MEDIA / f"{name}.png"
    if film.exists():
        return [
            f'<video controls muted loop playsinline preload="none" poster="{name}.png" src="{name}.mp4"',
            f'  aria-label="{name}: uncontrolled above, the shipped policy below, two readings over time"></video>',
            "",
            "The vorticity of the uncontrolled flow above, of the controlled one below. Red turns counter-clockwise.",
            "",
        ]
    return [f"![The vorticity of {name}, uncontrolled]({name}.png)", ""] if picture.exists() else []


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    lines = [heads, ["---"] * len(heads), *rows]
    return ["| " + " | ".join(line) + " |" for line in lines] + [""]


def _facts(case: Case, base: Baseline) -> list[str]:
    """Return what the flow is without control."""
    free, scales = base.statistics, case.scales
    rows = [
        ["Reynolds number U L / ν", f"{case.reynolds:g}"],
        ["L, U in the case's units", f"{scales.length:g}, {scales.velocity:g}"],
        ["triangles, time step", f"{len(base.mesh.triangles)}, {case.dt:g}"],
        ["uncontrolled flow", free.kind],
    ]
    if free.period:
        rows.append(["Strouhal number", f"{case.convective_time / free.period:.4f}"])
    for name, moments in free.readings.items():
        if name in ("c_d", "c_l") or name in {s.name for s in case.sensors}:
            rows.append([f"{_reading(name)}: mean, rms", f"{_number(moments.mean)}, {_number(moments.rms)}"])
            if name in base.steady and math.isfinite(base.steady[name]) and name != "c_l":
                rows.append([f"{_reading(name)} of the steady flow", _number(base.steady[name])])
    return [
        "## Without control",
        "",
        *_table(["what", "value"], rows),
        "Coefficients are 2F / (ρ U² L) for all bodies together: drag positive downstream, lift positive up.",
        "",
    ]


def _number(value: float) -> str:
    return f"{value:.4f}" if abs(value) >= 5e-5 else "0"


def _reading(name: str) -> str:
    head, _, of = name.partition(".")
    symbol = {"c_d": "C_D", "c_l": "C_L", "c_m": "C_M"}.get(head, f"`{head}`")
    return symbol + (f" of {of}" if of else "")


def _use(definition: Definition) -> list[str]:
    name, lines = definition.name, [f"manywake train --case {definition.name}"]
    if definition.policy is not None:
        lines.append(f"manywake evaluate --case {name} --pretrained")
        lines.append(f"manywake movie --case {name} --pretrained -o {name}.mp4")
    block = ["## Use", "", "```", *lines, "```", ""]
    for spec in gymnasium.registry.values():
        if spec.namespace == "manywake" and spec.kwargs.get("case") == name:
            block += ["```python", "import gymnasium, manywake", "", f'env = gymnasium.make("{spec.id}")', "```", ""]
    return block


def _kind(given: Input) -> str:
    names = {Jet: "jet", Rotation: "rotation", Gust: "gust", BodyForce: "body force"}
    return next(word for kind, word in names.items() if isinstance(given, kind))


def _controlled(case: Case, task: Task) -> list[str]:
    mixing = tasks.matrix(task, len(case.actuators))
    rows = []
    for k, actuator in enumerate(case.actuators):
        of = " ".join(f"{weight:+.3g} a{n}" for n, weight in enumerate(mixing[k]) if weight)
        rows.append([f"`{actuator.on}`", _kind(actuator), f"± {actuator.limit:g}", actuator.unit, of])
    acted = spaces(case, task)[1]
    actions = acted.shape[0]
    return [
        "## What is controlled",
        "",
        f"{'One action' if actions == 1 else f'{actions} actions'} in [-1, 1]: "
        f"{_box(acted)}. An amplitude is its limit times the mixture in the last column.",
        "",
        *_table(["actuator", "kind", "limit", "unit of the amplitude", "mixture"], rows),
        _law(task.law, case),
        "",
        *_disturbed(case),
    ]


def _box(space: Box) -> str:
    return f"`Box({space.low.min():g}, {space.high.max():g}, {space.shape}, {space.dtype})`"


def _law(law: Law, case: Case) -> str:
    if isinstance(law, Held):
        return "The amplitude is held over the action, without smoothing."
    if isinstance(law, Exponential):
        return (
            f"The amplitude c follows what is wanted, a, by c += α (a - c) with α = {law.alpha:g} every {law.per:g} "
            "units of time."
        )
    return "The amplitude ramps over the action from the last one to the new one."


def _disturbed(case: Case) -> Iterator[str]:
    for noise in case.disturbances:
        assert isinstance(noise, Noise)
        yield (
            f"Chance drives `{noise.by.on}` ({_kind(noise.by)}): rms {noise.rms:.3g}, correlation time {noise.time:g}. "
            "It is drawn from the episode's seed."
        )
        yield ""


def _observed(case: Case, task: Task) -> list[str]:
    sensors, rows, at = {s.name: s for s in case.sensors}, [], 0
    for name in task.observe:
        count = values(sensors[name]) if name in sensors else len(case.actuators) if name == "amplitudes" else 1
        what, unit = _sensor(sensors[name]) if name in sensors else _observed_reading(name)
        place = f"{at}" if count == 1 else f"{at} to {at + count - 1}"
        rows.append([place, f"`{name}`", what, unit])
        at += count
    also = f" The agent sees the last {task.history} at once." if task.history > 1 else ""
    return [
        "## What is observed",
        "",
        f"{_box(spaces(case, task)[0])}. Sensors are read at the end of an action.{also}",
        "",
        *_table(["index", "name", "what", "unit"], rows),
    ]


def _sensor(sensor: Sensor) -> tuple[str, str]:
    if isinstance(sensor, Probes):
        both, count = "u and v at" if sensor.field == "velocity" else "pressure at", len(sensor.points)
        return f"{both} {'one point' if count == 1 else f'each of {count} points'}", sensor.unit
    if isinstance(sensor, Shear):
        return f"wall shear, integrated over `{sensor.on}`", sensor.unit
    assert isinstance(sensor, Energy)
    return "half the integral of (u - u_steady)²", sensor.unit


def _observed_reading(name: str) -> tuple[str, str]:
    if name == "amplitudes":
        return "amplitudes of all actuators", "their limits"
    return f"{_reading(name)}, mean over the last action", "2F / (ρ U² L)" if name.startswith("c_") else "coefficient"


def _rewarded(definition: Definition) -> list[str]:
    reward = definition.task.reward  # type: ignore[union-attr]
    source = textwrap.dedent(inspect.getsource(reward)).strip()
    return [
        "## Reward",
        "",
        "Of each action. `now` holds means over the action, `free` those of the uncontrolled flow.",
        "",
        *("```python", source, "```", ""),
    ]


def _episode(definition: Definition, base: Baseline) -> list[str]:
    task, case = definition.task, definition.case
    assert task is not None
    long = task.interval * task.actions
    starts = "one of several developed states, drawn by the seed" if task.starts == "any" else "one developed state"
    rows = [
        ["interval between actions", f"{task.interval:g} ({task.steps(case.dt)} time steps)"],
        ["actions", f"{task.actions}"],
        ["length", f"{long:g} ({long / case.convective_time:g} L/U)"],
        ["start", starts],
        ["end", "`truncated` after the last action"],
        ["a flow that blows up", "`terminated`, with `Task.charge` as its reward"],
    ]
    if task.reynolds_numbers:
        numbers = ", ".join(f"{re:g}" for re in task.reynolds_numbers)
        rows.insert(3, ["Reynolds number", f"drawn by the seed from {numbers}; not observed"])
    if base.statistics.period:
        rows.insert(3, ["length in periods of the uncontrolled flow", f"{long / base.statistics.period:.1f}"])
    return ["## Episode", "", *_table(["what", "value"], rows)]


def _references(name: str) -> list[str]:
    path = VALIDATED / f"{name}.json"
    if not path.exists():
        return []
    checks: list[dict[str, Any]] = json.loads(path.read_text())["checks"]
    rows = []
    for check in checks:
        ours, theirs = float(check["ours"]), float(check["reference"])
        relative = check["kind"] in ("relative", "reported") and theirs
        off = f"{100 * (ours / theirs - 1):+.2f} %" if relative else ""
        within = {"relative": f"{100 * check['tolerance']:.3g} %", "absolute": f"{check['tolerance']:.2g}"}
        rows.append(
            [
                check["name"],
                f"{ours:.5g}",
                f"{theirs:.5g}",
                off,
                within.get(check["kind"], check["kind"]),
                check["source"],
            ]
        )
    return [
        "## References",
        "",
        f"`manywake validate --case {name}` computes these.",
        "",
        *_table(["quantity", "ours", "theirs", "deviation", "tolerance", "source"], rows),
    ]


def _compared(definition: Definition) -> list[str]:
    """Return the flow's section of the page of policies and simple controllers."""
    if definition.task is None:
        return []
    found = re.search(rf"^## `{definition.name}`[^\n]*\n(.*?)(?=^## |\Z)", CONTROLLERS.read_text(), re.DOTALL | re.M)
    if found is None:
        return []
    return [
        "## Policies and simple controllers",
        "",
        "What the columns mean: [policies beside simple controllers](../controllers.md).",
        "",
        re.sub(r"\]\((?!https?:|#|\.\./)", "](../", found.group(1)).strip(),
        "",
    ]
