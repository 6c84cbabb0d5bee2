"""Cases by name or by file, with single settings overridden: strings become objects here.

A case file has CASE and TASK. It may have REWARDS (name -> function), LEARNING, PROTOCOLS (name -> (Task, Learning))
and REFERENCES.
"""

import dataclasses
import hashlib
import importlib
import importlib.util
import pkgutil
import sys
import typing
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import cloudpickle
import docstring_parser

from manywake import suite
from manywake.case import door
from manywake.case.case import Case
from manywake.case.learning import Learning
from manywake.case.references import Reference
from manywake.case.schemes import SCHEMES
from manywake.case.task import Reward, Task

DEFAULT = "cylinder-jets"


@dataclass(frozen=True)
class Definition:
    """What a case file says. file: its path. sha256: of the file; None for a case made in Python.

    protocols: task and learner's settings by name; "default" is TASK and LEARNING.
    """

    name: str
    case: Case
    protocols: Mapping[str, tuple[Task, Learning]]
    rewards: Mapping[str, Reward] = field(default_factory=dict)
    references: tuple[Reference, ...] = ()
    file: Path | None = None
    sha256: str | None = None

    @property
    def shipped(self) -> bool:
        """Whether it comes with the package, so that its name is enough to find it again."""
        return self.file is not None and self.file.parent == Path(__file__).parent

    def protocol(self, name: str) -> tuple[Task, Learning]:
        """Return task and learner's settings by name; ValueError names those there are."""
        if name not in self.protocols:
            raise ValueError(f"protocol: got {name!r}, wanted one of {', '.join(self.protocols)}")
        return self.protocols[name]


@dataclass(frozen=True)
class Chosen:
    """A definition with its settings chosen: what is played, and by which settings it is learnt."""

    definition: Definition
    case: Case
    task: Task
    learning: Learning
    protocol: str = "default"
    overrides: Mapping[str, Any] = field(default_factory=dict)


def names() -> list[str]:
    """Return the names of the shipped cases."""
    found = [module.name.replace("_", "-") for module in pkgutil.iter_modules(suite.__path__)]
    return sorted(name for name in found if name != "load")


def load(case: str | Path | Case, task: Task | None = None) -> Definition:
    """Return a shipped case by its name, a user's by the path of its file, or one made in Python with its task.

    Raises ValueError when there is no such case, when the file is missing, does not run, or lacks CASE or TASK.
    """
    if isinstance(case, Case):
        if task is None:
            raise ValueError("task: got none, wanted task=Task(...) beside a case that is made in Python")
        return Definition("python", case, {"default": (task, Learning())}, {_name(task.reward): task.reward})
    if str(case) in names():
        module = importlib.import_module(f"manywake.suite.{str(case).replace('-', '_')}")
        path = Path(str(module.__file__))
        return _definition(str(case), module, path, path.read_bytes())
    path = Path(case)
    if path.suffix != ".py":
        raise ValueError(f"case: got {str(case)!r}, wanted one of {', '.join(names())}, or the path of a .py file")
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ValueError(f"case: cannot read {path} ({error.strerror}), wanted the path of a case file") from error
    return _definition(path.stem, _run(path, content), path.resolve(), content)


def _run(path: Path, content: bytes) -> ModuleType:
    """Run a user's case file as a module of its own."""
    name = f"manywake_case_{hashlib.sha256(content + str(path.resolve()).encode()).hexdigest()[:16]}"
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        exec(compile(content, str(path), "exec"), vars(module))
    except Exception as error:
        del sys.modules[name]
        line = _line(error, str(path))
        raise ValueError(f"case: {path}{line} fails ({type(error).__name__}: {error})") from error
    # its functions travel to workers as what they are, for the file may not be there
    cloudpickle.register_pickle_by_value(module)
    return module


def _line(error: Exception, path: str) -> str:
    if isinstance(error, SyntaxError):
        return f", line {error.lineno}," if error.lineno else ""
    trace, found = error.__traceback__, None
    while trace is not None:
        if trace.tb_frame.f_code.co_filename == path:
            found = trace.tb_lineno
        trace = trace.tb_next
    return f", line {found}," if found else ""


def _definition(name: str, module: ModuleType, path: Path, content: bytes) -> Definition:
    for attribute, kind in (("CASE", Case), ("TASK", Task)):
        if not isinstance(getattr(module, attribute, None), kind):
            got = type(getattr(module, attribute)).__name__ if hasattr(module, attribute) else "nothing"
            raise ValueError(f"case: {path} has {got} as {attribute}, wanted {attribute} = {kind.__name__}(...)")
    task = module.TASK
    default = (task, getattr(module, "LEARNING", Learning()))
    return Definition(
        name,
        module.CASE,
        {"default": default, **getattr(module, "PROTOCOLS", {})},
        getattr(module, "REWARDS", {_name(task.reward): task.reward}),
        tuple(getattr(module, "REFERENCES", ())),
        path,
        hashlib.sha256(content).hexdigest(),
    )


def _name(function: Any) -> str:
    return getattr(function, "__name__", "reward")


def choose(case: str | Path | Case, task: Task | str | None = None, **overrides: Any) -> Chosen:
    """Return a case with its settings chosen; ValueError at the door.

    case: a shipped one by name, the path of a case file, or a `Case`. task: a protocol of the file by name, or a
    `Task`. overrides: as in `override`.
    """
    if task is None or isinstance(task, str):
        return override(load(case), task or "default", overrides)
    definition = load(case, task)
    learning = definition.protocol("default")[1]
    definition = replace(definition, protocols={**definition.protocols, "default": (task, learning)})
    return override(definition, "default", overrides)


def override(definition: Definition, protocol: str, overrides: Mapping[str, Any]) -> Chosen:
    """Return a definition with single settings overridden, by their names in `settings`; ValueError at the door.

    Beside those names every field of `Case`, `Task` and `Learning` can be given as an object.
    """
    case, (task, learning) = definition.case, definition.protocol(protocol)
    known = settings(definition, protocol)
    whole = {f.name for kind in (Case, Task, Learning) for f in dataclasses.fields(kind)}
    for name, value in overrides.items():
        if name not in known and name not in whole:
            raise ValueError(f"got the setting {name!r}, wanted one of {', '.join(sorted({*known, *whole}))}")
        value = _object(definition, task, name, value)
        head, _, tail = name.partition(".")
        if head == "limit":
            actuators: tuple[Any, ...] = case.actuators
            actuators = tuple(replace(a, limit=value) if tail in ("", a.on) else a for a in actuators)
            case = replace(case, actuators=actuators)
        elif head == "points":
            points = tuple((float(x), float(y)) for x, y in value)
            sensors: tuple[Any, ...] = case.sensors
            sensors = tuple(replace(s, points=points) if s.name == tail else s for s in sensors)
            case = replace(case, sensors=sensors)
        elif head == "sizes" and tail:
            case = replace(case, sizes=replace(case.sizes, **{tail: value}))
        elif head == "law" and tail:
            task = replace(task, law=replace(task.law, **{tail: value}))  # type: ignore[type-var]
        elif head in {f.name for f in dataclasses.fields(Case)}:
            case = replace(case, **{head: value})
        elif head in {f.name for f in dataclasses.fields(Task)}:
            task = replace(task, **{head: value})
        else:
            learning = replace(learning, **{head: value})
    door.check(case, task)
    return Chosen(definition, case, task, learning, protocol, dict(overrides))


def _object(definition: Definition, task: Task, name: str, value: Any) -> Any:
    """Return what a string stands for: a scheme, a reward or a law by its name."""
    if not isinstance(value, str):
        return value
    laws = {type(given.law).__name__.lower(): given.law for given, _ in definition.protocols.values()}
    laws[type(task.law).__name__.lower()] = task.law
    by_name: dict[str, Mapping[str, Any]] = {"scheme": SCHEMES, "reward": definition.rewards, "law": laws}
    if name not in by_name:
        return value
    if value not in by_name[name]:
        raise ValueError(f"{name}: got {value!r}, wanted one of {', '.join(by_name[name])}")
    return by_name[name][value]


@dataclass(frozen=True)
class Setting:
    """A setting by its name: what it is now, of which type, and what it means."""

    value: Any
    type: Any
    help: str


def settings(definition: Definition, protocol: str = "default") -> dict[str, Setting]:
    """Return every single setting of a case's flow and task; those of the learner are the fields of `Learning`."""
    case, (task, _) = definition.case, definition.protocol(protocol)
    found = {name: _field(case, name) for name in ("reynolds", "spin_up")}
    found["time_step"] = Setting(case.dt, float, _help(Case, "time_step"))
    found["scheme"] = Setting(case.scheme.name, tuple(SCHEMES), _help(Case, "scheme"))
    found |= {f"sizes.{f.name}": _field(case.sizes, f.name) for f in dataclasses.fields(case.sizes)}
    for a in case.actuators:
        found[f"limit.{a.on}"] = Setting(a.limit, float, f"Largest amplitude of {a.on} ({a.unit}).")
    if case.actuators:
        found["limit"] = Setting(None, float | None, "Largest amplitude of every actuator.")
    for s in case.sensors:
        text = f"Points (x, y) of the sensor {s.name}."
        found[f"points.{s.name}"] = Setting(s.points, tuple[tuple[float, float], ...], text)
    found |= {name: _field(task, name) for name in ("interval", "actions", "observe")}
    rewards = tuple(definition.rewards)
    found["reward"] = Setting(_reward_name(definition, task), rewards, f"What is rewarded: {', '.join(rewards)}.")
    laws = tuple(dict.fromkeys(type(t.law).__name__.lower() for t, _ in definition.protocols.values()))
    found["law"] = Setting(type(task.law).__name__.lower(), laws, _help(Task, "law"))
    found |= {f"law.{f.name}": _field(task.law, f.name) for f in dataclasses.fields(task.law)}  # type: ignore[arg-type]
    return found


def _reward_name(definition: Definition, task: Task) -> str:
    return next((name for name, f in definition.rewards.items() if f is task.reward), _name(task.reward))


def _field(owner: Any, name: str) -> Setting:
    return Setting(getattr(owner, name), _types(type(owner))[name], _help(type(owner), name))


def _types(kind: type) -> dict[str, Any]:
    return typing.get_type_hints(kind)


def _help(kind: type, name: str) -> str:
    """Return the sentence that stands below a field."""
    parsed = docstring_parser.parse_from_object(kind)
    return next((p.description or "" for p in parsed.params if p.arg_name == name), "").replace("\n", " ")
