"""Every option of every command says what it is, in a sentence, and in which unit."""

import argparse
import re
import warnings
from collections.abc import Iterator

import pytest
import tyro

from manywake.cli import main
from manywake.suite import load

WORDS = [
    *(["validate", "--case", name] for name in load.names()),
    *([command, "--controller", "none"] for command in ("evaluate", "movie", "export")),
]
"""What is typed, so that together all commands have all the options that they can have."""


def commands(words: list[str]) -> dict[str, argparse.ArgumentParser]:
    """The commands that the command line has where these words are typed."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # tyro has no other way to ask for its options
        parser = tyro.extras.get_parser(main._commands(words))
    return next(dict(action.choices) for action in parser._actions if isinstance(action.choices, dict))


def said(words: list[str]) -> Iterator[tuple[str, str]]:
    """Each option, with its command, and what its help says beside default and choices."""
    for command, parser in commands(words).items():
        for action in parser._actions:
            if action.help != argparse.SUPPRESS and "--help" not in action.option_strings:
                text = re.sub(r"\s*\((?:default|required|optional|repeatable|sets)\b.*\)\s*$", "", action.help or "")
                yield f"{command} {'/'.join(action.option_strings) or action.dest}", text.strip()


@pytest.mark.parametrize("words", WORDS, ids=" ".join)
def test_no_option_is_without_a_sentence(words):
    found = dict(said(words))
    assert len(found) > 50
    assert [name for name, text in found.items() if not re.fullmatch(r"\S.*[.?]", text, re.DOTALL)] == []


def test_the_words_bring_out_all_commands():
    every = {command for words in WORDS for command in commands(words)}
    assert {"train", "resume", "evaluate", "replay", "compare", "search", "movie", "export", "doctor"} <= every
    assert {"validate", "mesh", "baseline", "figure", "bench"} <= every


def test_times_and_limits_have_units():
    found = dict(said(["train", "--case", "cylinder-jets"]))
    interval, limit = found["train --interval"], found["train --limit.cylinder.top"]
    assert interval.endswith("in the case's unit of time; a multiple of the time step. In that unit L/U is 0.1.")
    assert "flow rate per unit depth" in limit and limit.endswith("in the case's units, in which L is 0.1 and U 1.")
    assert found["train --noise.pressure"].endswith("in the case's unit of velocity squared.")
    assert found["train --update-seconds"].endswith("in seconds.")
