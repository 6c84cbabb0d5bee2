"""The pages that are made of the code say what the code does, and the reader of prose finds what is too long."""

import re

import gymnasium
import numpy as np
import pytest

from manywake.case import task as tasks
from manywake.suite import load
from website import command_pages, flow_pages, prose


@pytest.mark.parametrize("name", load.names())
def test_every_shipped_flow_has_a_page_of_its_file(name):
    definition, page = load.load(name), flow_pages.page(name)
    assert page.startswith(f"# {name}\n")
    headings = re.findall(r"^## (.*)$", page, re.MULTILINE)
    assert "Without control" in headings
    assert f"| {definition.case.reynolds:g} |" in page
    if definition.task is not None:
        assert {"Use", "What is controlled", "What is observed", "Reward", "Episode"} <= set(headings)
        for actuator in definition.case.actuators:
            assert f"| `{actuator.on}` |" in page and f"± {actuator.limit:g}" in page
        assert f"def {definition.task.reward.__name__}(now, free)" in page


def test_the_page_of_a_flow_counts_what_the_environment_has():
    page, env = flow_pages.page("pinball"), gymnasium.make("manywake/Pinball-v0")
    values, actions, low = env.observation_space.shape[0], env.action_space.shape[0], env.observation_space.low
    env.close()
    assert f"`Box({low[0]:g}, {-low[0]:g}, ({values},), float32)`" in page
    assert f"`Box(-1, 1, ({actions},), float32)`" in page
    assert np.array_equal(tasks.matrix(load.load("pinball").task, 3), np.eye(3)) and "+1 a2" in page


def test_the_page_of_commands_has_every_command_and_option():
    page = command_pages.page()
    for command in ("train", "resume", "evaluate", "search", "replay", "compare", "movie", "export", "validate"):
        assert f"\n## {command}\n" in page
    assert "`--seed INT`" in page and "Seed of the run" in page


def test_long_sentences_and_cells_are_found_and_named(tmp_path, monkeypatch):
    monkeypatch.setattr(prose, "ROOT", tmp_path)
    page = tmp_path / "page.md"
    fits, long = "Word " * 35, "Word " * 36
    page.write_text(f"# Title\n\n{fits}. {fits}.\n\n- {fits}\n- `some code` {fits}\n\n```\n{long}\n```\n")
    assert [place.split(": ")[:2] for place in prose.long(page)] == [["page.md:6", "36 words, at most 35 a sentence"]]
    page.write_text(f"{long}.\n\n| head |\n|---|\n| {'Word ' * 12} |\n| {'Word ' * 13} |\n")
    assert [place.split(": ")[0] for place in prose.long(page)] == ["page.md:1", "page.md:6"]


def test_a_formula_counts_as_a_word():
    assert prose.words(prose.FORMULA.sub("formula", "where $a + b = c$ holds")) == 3
