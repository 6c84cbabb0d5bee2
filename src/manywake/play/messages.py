"""What a page may ask for: small JSON objects, bounded in size, checked before anything is done with them.

{"type": "drive", "by": "policy"} becomes Drive(by="policy").
"""

import json
import math
from dataclasses import dataclass, fields
from typing import Any, get_type_hints

from typeguard import TypeCheckError, check_type

LONGEST = 4096
"""Characters of a message."""
DIGITS = 15
"""Of a whole number."""
SLOWEST, FASTEST = 0.25, 20.0
"""Speeds that can be asked for, in L/U a second."""


@dataclass(frozen=True)
class Drive:
    """Who drives the controlled flow from now on."""

    by: str


@dataclass(frozen=True)
class Hand:
    """What the hand does, an action in [-1, 1] each."""

    actions: tuple[float, ...]


@dataclass(frozen=True)
class Pause:
    """Stop, or go on."""

    on: bool


@dataclass(frozen=True)
class Step:
    """Stop, and take one action."""


@dataclass(frozen=True)
class Reset:
    """Begin both flows anew."""


@dataclass(frozen=True)
class Speed:
    """How fast the flow runs, in L/U a second."""

    value: float


@dataclass(frozen=True)
class Field:
    """What is drawn."""

    name: str


@dataclass(frozen=True)
class Open:
    """Another flow, by one of the names that are offered. reynolds: that of its file when not given."""

    case: str
    reynolds: float | None = None


@dataclass(frozen=True)
class Cancel:
    """Stop making a flow, and go on with the one before."""


@dataclass(frozen=True)
class Score:
    """Begin anew, and count how well the hand does."""


@dataclass(frozen=True)
class Seen:
    """A frame was drawn: the page is ready for another."""

    frame: int


Message = Drive | Hand | Pause | Step | Reset | Speed | Field | Open | Cancel | Score | Seen
_KINDS: dict[str, Any] = {kind.__name__.lower(): kind for kind in Message.__args__}  # type: ignore[attr-defined]


def parse(text: str) -> Message:
    """Return what a message asks for; ValueError, with the reason, where it is none."""
    if len(text) > LONGEST:
        raise ValueError(f"message: got {len(text)} characters, wanted at most {LONGEST}")
    try:
        said = json.loads(text, parse_int=_whole, parse_constant=_refused)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"message: wanted JSON ({str(error)[:80]})") from None
    kind = _KINDS.get(said.pop("type", None)) if isinstance(said, dict) and _named(said) else None
    if kind is None:
        raise ValueError(f"message: wanted an object with a type, one of {', '.join(_KINDS)}")
    known, hints, given = {field.name for field in fields(kind)}, get_type_hints(kind), {}
    if unknown := set(said) - known:
        raise ValueError(f"message: {kind.__name__.lower()} has no {sorted(unknown)[0][:40]!r}, wanted {sorted(known)}")
    for name, value in said.items():
        given[name] = tuple(value) if isinstance(value, list) else value
        try:
            check_type(given[name], hints[name])
        except TypeCheckError:
            raise ValueError(f"message: {name} of {kind.__name__.lower()} is of another type") from None
        if not _finite(given[name]):
            raise ValueError(f"message: {name} of {kind.__name__.lower()} is not finite")
    try:
        return kind(**given)
    except TypeError:
        raise ValueError(f"message: {kind.__name__.lower()} wants {sorted(known)}") from None


def _named(said: dict[str, Any]) -> bool:
    return isinstance(said.get("type"), str)


def _whole(digits: str) -> int:
    if len(digits) > DIGITS:
        raise ValueError("a number is too long")
    return int(digits)


def _refused(constant: str) -> float:
    raise ValueError(f"{constant} is no number")


def _finite(value: Any) -> bool:
    parts = value if isinstance(value, tuple) else (value,)
    return all(not isinstance(part, float) or math.isfinite(part) for part in parts)


def error(text: str) -> str:
    """Return what tells a page that its message was not done."""
    return json.dumps({"type": "error", "message": text})
