"""The page of commands and their options, made of the command line's own parser."""

import argparse
import html
import warnings
from collections.abc import Iterator
from typing import Any

import tyro

from manywake.cli import main

LIKE = (
    ("train", ["train"]),
    ("resume", []),
    ("evaluate", []),
    ("evaluate --controller", ["evaluate", "--controller", "none"]),
    ("search", ["search"]),
    ("replay", []),
    ("compare", []),
    ("movie", []),
    ("export", []),
    ("export-policy", []),
    ("validate", ["validate"]),
    ("mesh", ["mesh"]),
    ("baseline", ["baseline"]),
    ("play", []),
    ("doctor", []),
    ("figure", []),
    ("bench", []),
)
"""Commands in the order of the page, each with the words that make the command line have it."""


def page() -> str:
    """Return the page."""
    lines = [
        "# Commands",
        "",
        "Made of the code, as `manywake COMMAND --help` shows it. Settings of a flow and its task have the values of"
        " `cylinder-jets` here; `--case NAME` shows those of another. `manywake --version` names the version.",
        "",
    ]
    for title, words in LIKE:
        lines += _command(title, _parser(words).get(title.split()[0]))
    return "\n".join(lines)


def _parser(words: list[str]) -> dict[str, argparse.ArgumentParser]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # tyro has no other way to ask for its options
        parser = tyro.extras.get_parser(main._commands(words), prog="manywake")
    return next(action.choices for action in parser._actions if isinstance(action.choices, dict))


def _command(title: str, parser: argparse.ArgumentParser | None) -> Iterator[str]:
    if parser is None:
        return
    yield from (f"## {title}", "", _joined(parser.description or ""), "")
    for group in parser._action_groups:
        options = [action for action in group._group_actions if action.help != argparse.SUPPRESS and _name(action)]
        options = [action for action in options if "--help" not in action.option_strings]
        if not options:
            continue
        kind = (group.title or "").removesuffix(" options")
        if kind not in ("options", "positional arguments", ""):
            yield from (f"**{kind.capitalize()}.** {_joined(group.description or '')}", "")
        for action in options:
            yield from (f"`{_name(action)}`", f":   {_joined(action.help or '')}", "")


def _name(action: argparse.Action) -> str:
    metavar: Any = action.metavar
    value = metavar if isinstance(metavar, str) else " ".join(metavar or ())
    value = value.replace("{None}|", "")
    return " ".join(filter(None, [", ".join(action.option_strings), "" if action.nargs == 0 else value]))


def _joined(text: str) -> str:
    """Return a text of the parser as markdown: its percent signs are doubled, its brackets are no tags."""
    plain = text.replace("%%", "%").replace("(default: None)", "")
    return html.escape(" ".join(plain.split()), quote=False)
