"""Cases by name or by file, with single settings overridden: strings become objects here.

A case file has CASE, and TASK if anything is to be learnt. It may have REWARDS (name -> function), LEARNING, PROTOCOLS
(name -> (Task, Learning)) and REFERENCES.
"""

import dataclasses
import hashlib
import pkgutil
import runpy
import traceback
import typing
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import docstring_parser

from manywake import suite
from manywake.case import door
from manywake.case import references as given
from manywake.case import task as tasks
from manywake.case.case import Case
from manywake.case.inputs import Input
from manywake.case.laws import Held, Law, Linear
from manywake.case.learning import Learning
from manywake.case.references import Reference
from manywake.case.schemes import SCHEMES
from manywake.case.sensors import Probes
from manywake.case.task import Reward, Task

DEFAULT = "cylinder-jets"
_TASK = ("interval", "actions", "observe", "history", "delay", "reward", "law", "starts", "reynolds_numbers")
"""Settings of a task by their fields."""


@dataclass(frozen=True)
class Definition:
    """What a case file says. file: its path, None for a case made in Python. content: what the file held.

    protocols: task and learner's settings by name; "default" is TASK and LEARNING, and absent without a TASK.
    controllers: the numbers of the best simple controllers that were found, by the controllers' names.
    """

    name: str
    case: Case
    protocols: Mapping[str, tuple[Task, Learning]]
    rewards: Mapping[str, Reward]
    references: tuple[Reference, ...] = ()
    file: Path | None = None
    content: bytes = b""
    controllers: Mapping[str, tuple[float, ...]] = field(default_factory=dict)

    @property
    def sha256(self) -> str | None:
        return None if self.file is None else hashlib.sha256(self.content).hexdigest()

    @property
    def shipped(self) -> bool:
        """Whether it comes with the package, so that its name is enough to find it again."""
        return self.file is not None and self.file.parent == Path(__file__).parent

    @property
    def policy(self) -> Path | None:
        """The file of the policy that ships with it, if there is one."""
        path = Path(__file__).parent / "policies" / f"{self.name}.npz"
        return path if self.shipped and path.exists() else None

    @property
    def task(self) -> Task | None:
        """The task of the default protocol, None where there is none."""
        return self.protocols["default"][0] if "default" in self.protocols else None

    def protocol(self, name: str) -> tuple[Task, Learning]:
        if not self.protocols or name == "default" and self.task is None:
            raise ValueError(
                f"task: got none in {self.file}, wanted TASK = Task(...) to train, evaluate or play with; "
                "validate and baseline do without"
            )
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

    @property
    def cases(self) -> tuple[Case, ...]:
        """The case at each Reynolds number that an episode may have."""
        return tuple(replace(self.case, reynolds=re) for re in self.task.reynolds_numbers) or (self.case,)


class UnknownSetting(ValueError):
    """A setting that a case, its task and its learner do not have."""

    def __init__(self, name: str, known: set[str]):
        self.wanted = f"{name!r}, wanted one of {', '.join(sorted(known))}"
        super().__init__(f"got the setting {self.wanted}")


def names() -> list[str]:
    """Return the names of the shipped cases."""
    return [module.name.replace("_", "-") for module in pkgutil.iter_modules(suite.__path__) if module.name != "load"]


def load(case: str | Path | Case, task: Task | None = None) -> Definition:
    """Return a shipped case by its name, a user's by the path of its file, or one made in Python with its task.

    Raises ValueError when there is no such case, when the file is missing, does not run, or lacks a CASE.
    """
    if isinstance(case, Case):
        if task is None:
            raise ValueError("task: got none, wanted task=Task(...) beside a case that is made in Python")
        return Definition("python", case, {"default": (task, Learning())}, {_name(task.reward): task.reward})
    if str(case) in names():
        module = import_module(f"manywake.suite.{str(case).replace('-', '_')}")
        path = Path(str(module.__file__))
        return _definition(str(case), vars(module), path, path.read_bytes())
    path = Path(case)
    if path.suffix != ".py":
        raise ValueError(f"case: got {str(case)!r}, wanted one of {', '.join(names())}, or the path of a .py file")
    if not path.is_file():
        raise ValueError(f"case: got {path}, which is no file, wanted the path of a case file")
    content = path.read_bytes()
    try:
        # what it defines belongs to no module, so it travels to workers as what it is (cloudpickle)
        said = runpy.run_path(str(path), run_name="manywake_case")
    except Exception as error:
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
        line = error.lineno if isinstance(error, SyntaxError) else lines[-1] if lines else "?"
        raise ValueError(f"case: {path}, line {line}, fails ({type(error).__name__}: {error})") from error
    return _definition(path.stem, said, path.resolve(), content)


def _definition(name: str, said: Mapping[str, Any], path: Path, content: bytes) -> Definition:
    for word, kind in (("CASE", Case), ("TASK", Task)):
        if not isinstance(said.get(word), kind) and (word in said or kind is Case):
            got = type(said[word]).__name__ if word in said else "nothing"
            raise ValueError(f"case: {path} has {got} as {word}, wanted {word} = {kind.__name__}(...)")
    task, case = said.get("TASK"), said["CASE"]
    default = {} if task is None else {"default": (task, said.get("LEARNING", Learning()))}
    protocols = {**default, **said.get("PROTOCOLS", {})}
    for word, both in protocols.items():
        if not isinstance(both, tuple) or [type(part) for part in both] != [Task, Learning]:
            raise ValueError(f"case: {path} has {both!r} as the protocol {word!r}, wanted (Task(...), Learning(...))")
    rewards = said.get("REWARDS", {} if task is None else {_name(task.reward): task.reward})
    references = tuple(said.get("REFERENCES", ()))
    given.check(case, references)
    return Definition(name, case, protocols, rewards, references, path, content, said.get("CONTROLLERS", {}))


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
    learning = definition.protocol("default")[1] if definition.task is not None else Learning()
    protocols = {**definition.protocols, "default": (task, learning)}
    return override(replace(definition, protocols=protocols), "default", overrides)


def override(definition: Definition, protocol: str, overrides: Mapping[str, Any]) -> Chosen:
    """Return a definition with single settings overridden, by their names in `settings`; ValueError at the door.

    Beside those names every field of `Case`, `Task` and `Learning` can be given as an object. A Reynolds number that is
    given is that of every episode.
    """
    task, learning = definition.protocol(protocol)
    if "reynolds" in overrides and "reynolds_numbers" not in overrides:
        task = replace(task, reynolds_numbers=())
    laws = _laws(definition, task)
    known = {*settings(definition, protocol), *(name for law in laws.values() for name in _fields(law, "law."))}
    words = {"scheme": SCHEMES, "reward": definition.rewards, "law": laws}
    case, task, learning = _replaced((definition.case, task, learning), known, words, overrides)
    door.check(case, task)
    return Chosen(definition, case, task, learning, protocol, dict(overrides))


def override_case(definition: Definition, overrides: Mapping[str, Any]) -> Case:
    """Return the case of a definition, which may have no task, with single settings of the flow overridden."""
    known = set(case_settings(definition.case))
    return _replaced((definition.case,), known, {"scheme": SCHEMES}, overrides)[0]


def _replaced(
    given: tuple[Any, ...], known: set[str], words: Mapping[str, Mapping[str, Any]], overrides: Mapping[str, Any]
) -> list[Any]:
    """Return data classes with settings overridden. known: names beside fields. words: what strings stand for."""
    owners: dict[type, Any] = {type(owner): owner for owner in given}
    of = {f.name: kind for kind in owners for f in dataclasses.fields(kind)}
    changed: dict[type, dict[str, Any]] = {kind: {} for kind in owners}  # replaced at once: some depend on each other
    for name, value in sorted(overrides.items(), key=lambda item: "." in item[0]):  # a whole, then parts of it
        if name not in {*of, *known}:
            raise UnknownSetting(name, {*of, *known})
        head, _, tail = name.partition(".")
        field = {"limit": "actuators", "points": "sensors", "noise": "sensors"}.get(head, head)
        now = changed[of[field]].get(field, getattr(owners[of[field]], field))
        value = _object(words.get(name), name, value)
        if head == "limit":
            value = tuple(_limited(a, value) if tail in ("", a.on) else a for a in now)
        elif head == "points":
            points = tuple((float(x), float(y)) for x, y in value)
            value = tuple(replace(s, points=points) if s.name == tail else s for s in now)
        elif head == "noise":
            value = tuple(replace(s, noise=value) if tail in ("", s.name) else s for s in now)
        elif tail:
            if not hasattr(now, tail):
                raise ValueError(f"{name}: got {value!r}, wanted none, as {type(now).__name__} has no {tail}")
            value = replace(now, **{tail: value})
        changed[of[field]][field] = value
    return [replace(owner, **changed[kind]) for kind, owner in owners.items()]


def _limited(actuator: Input, limit: float) -> Input:
    """Return an actuator with another limit, made for the strength that it was if that is enough."""
    kept = actuator.strongest if limit <= actuator.strongest else None
    return replace(actuator, limit=limit, strength=kept)


def _object(by_name: Mapping[str, Any] | None, name: str, value: Any) -> Any:
    """Return what a string stands for: a scheme, a reward or a law by its name."""
    if by_name is None or not isinstance(value, str):
        return value
    if value not in by_name:
        raise ValueError(f"{name}: got {value!r}, wanted one of {', '.join(by_name)}")
    return by_name[value]


def _laws(definition: Definition, task: Task) -> dict[str, Law]:
    """Return the laws that a word can stand for: those without parameters, and those that the case's file has."""
    laws: list[Law] = [Linear(), Held(), *(given.law for given, _ in definition.protocols.values()), task.law]
    return {type(law).__name__.lower(): law for law in laws}


@dataclass(frozen=True)
class Setting:
    """A setting: what it is now, of which type (or which of some words), and what it means."""

    value: Any
    type: Any
    help: str


def settings(definition: Definition, protocol: str = "default") -> dict[str, Setting]:
    """Return every single setting of a case's flow and task by name; those of the learner are fields of `Learning`."""
    task, _ = definition.protocol(protocol)
    reward = next((name for name, reward in definition.rewards.items() if reward is task.reward), _name(task.reward))
    found = case_settings(definition.case)
    found |= _fields(task, "", _TASK)
    found |= _fields(task.law, "law.")
    if task.reynolds_numbers:
        found["reynolds"] = Setting(None, float | None, "Re of every episode, in place of those that seeds draw from.")
    found["reward"] = Setting(reward, tuple(definition.rewards), "What is rewarded, of what the case's file has.")
    laws, found["starts"] = tuple(_laws(definition, task)), replace(found["starts"], type=tasks.STARTS)
    found["law"] = replace(found["law"], value=type(task.law).__name__.lower(), type=laws)
    found["interval"] = replace(found["interval"], help=f"{found['interval'].help} {_clock(definition.case)}")
    return found


def case_settings(case: Case) -> dict[str, Setting]:
    """Return every single setting of a case's flow by name."""
    points = tuple[tuple[float, float], ...]
    found = _fields(case, "", ("reynolds", "spin_up", "time_step", "scheme"))
    if case.mesh is None:
        found |= {name: size for name, size in _fields(case.sizes, "sizes.").items() if name != "sizes.near"}
    step, scales = found["time_step"], f"L is {case.scales.length:g} and U {case.scales.velocity:g}"
    found["time_step"] = replace(step, value=case.dt, type=float, help=f"{step.help} {_clock(case)}")
    found["scheme"] = replace(found["scheme"], value=case.scheme.name, type=tuple(SCHEMES))
    for a in case.actuators:
        found[f"limit.{a.on}"] = Setting(
            a.limit, float, f"Largest amplitude of {a.on} ({a.unit}), in the case's units, in which {scales}."
        )
    if case.actuators:
        found["limit"] = Setting(None, float | None, "Largest amplitude of every actuator, in its unit.")
    for s in case.sensors:
        found[f"noise.{s.name}"] = Setting(
            s.noise, float, f"Root mean square of the error of every value of {s.name}, in {s.unit}."
        )
    for s in (sensor for sensor in case.sensors if isinstance(sensor, Probes)):
        found[f"points.{s.name}"] = Setting(
            s.points, points, f"Points (x, y) of the sensor {s.name}, in the case's unit of length."
        )
    return found


def _clock(case: Case) -> str:
    """Say how a case's unit of time goes with its scales."""
    return f"In that unit L/U is {case.convective_time:g}."


def _fields(owner: Any, prefix: str, chosen: tuple[str, ...] = ()) -> dict[str, Setting]:
    """Return the fields of a data class as settings, each with the sentence that stands below it."""
    types = typing.get_type_hints(type(owner))
    try:
        params = docstring_parser.parse_from_object(type(owner)).params
    except TypeError:  # a class of a user's file: Python does not find the source again
        params = []
    said = {p.arg_name: (p.description or "").replace("\n", " ") for p in params}
    every = chosen or tuple(f.name for f in dataclasses.fields(owner))
    return {f"{prefix}{name}": Setting(getattr(owner, name), types[name], said.get(name, "")) for name in every}
