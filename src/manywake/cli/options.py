"""Options of the commands that take a case: its settings, as `suite.load` names them."""

import dataclasses
from dataclasses import dataclass
from typing import Annotated, Any

import tyro

from manywake.suite import load
from manywake.suite.load import Definition, Setting

OF_THE_TASK = ("interval", "actions", "observe", "reward", "law", "points")
"""Beginnings of the settings that change nothing of the flow itself."""


@dataclass(frozen=True)
class First:
    """What is looked at before the rest, because it chooses the defaults that the other options then override."""

    case: str = load.DEFAULT
    protocol: str = "default"


def first(words: list[str]) -> First:
    """Return the case and the protocol among the words of a command."""
    known, _ = tyro.cli(First, args=[w for w in words if w not in ("-h", "--help")], return_unknown_args=True)
    return known


def settings(definition: Definition, protocol: str, task: bool) -> type:
    """Return a data class with an option for each setting of a case; with `task`, for each of its task's too."""
    fields = [
        (name, setting)
        for name, setting in load.settings(definition, protocol).items()
        if task or name.partition(".")[0] not in OF_THE_TASK
    ]
    return dataclasses.make_dataclass("Settings", [_option(name, setting) for name, setting in fields], frozen=True)


def _option(name: str, setting: Setting) -> tuple[str, Any, Any]:
    kind, default, help = setting.type, setting.value, setting.help
    words = None
    if isinstance(kind, tuple):  # a word that is none of them is refused at the door, as all that does not fit
        words, kind = f"{{{','.join(kind)}}}", str
    if name.startswith("points."):
        kind, default, help = kind | None, None, f"{help} {len(setting.value)} in the case's file."
    option = tyro.conf.arg(name=name.replace("_", "-"), help=help, metavar=words)
    return name.replace(".", "__"), Annotated[kind, option], default  # type: ignore[valid-type]


def overrides(chosen: Any) -> dict[str, Any]:
    """Return the settings that are not what the case's file says, by name."""
    return {
        field.name.replace("__", "."): getattr(chosen, field.name)
        for field in dataclasses.fields(chosen)
        if getattr(chosen, field.name) != field.default
    }
