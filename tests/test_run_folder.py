"""The page about run folders names the columns and keys that the code writes, and no others."""

import csv
import json
import re
from dataclasses import fields
from pathlib import Path

import pytest

from manywake import api
from manywake.case.learning import Learning
from manywake.cli import runs as commands
from manywake.learn import flows, train
from manywake.learn.blocks import Layout
from manywake.learn.engine import Threads
from manywake.learn.settings import Collection, Settings
from manywake.suite import load

from .toy import LEARNING, Toy

PAGE = Path(__file__).parents[1] / "docs" / "run-folder.md"


def named(file: str) -> list[str]:
    """Return what the first column of a file's table names."""
    (part,) = re.findall(rf"^## `{re.escape(file)}`\n(.*?)(?=^## |\Z)", PAGE.read_text(), re.S | re.M)
    cells = [line.split("|")[1] for line in part.splitlines() if line.startswith("|")]
    return [name for cell in cells for name in re.findall(r"`([^`]+)`", cell)]


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    """A whole run of the default case, as the command leaves it."""
    folder = tmp_path_factory.mktemp("runs") / "a"
    learning = Learning(update_period=2, episodes=2, batch_size=4, hidden=(8,))
    simulation = flows.open_flows(load.choose("cylinder-jets", actions=2))
    opened = api.OpenRun(commands.Run(folder), simulation)

    def work(show) -> train.Trained:
        settings = Settings(learning, Collection(engine="serial"), 3)
        return train.train(folder, simulation, settings, Threads(1), Layout(2, 1, 2), show)

    assert commands._trained(work, opened, learning, 0, commands.Resume(folder, watch=True)) == 0
    return folder


@pytest.mark.parametrize("file", ["episodes.csv", "updates.csv", "wake.csv"])
def test_the_page_names_every_column_of_a_table_in_its_order(run, file):
    with open(run / file, newline="") as table:
        assert set(named(file)) == set(next(csv.reader(table)))
    assert len(named(file)) == len(set(named(file)))


def test_the_page_names_every_column_of_lost_blocks(tmp_path):
    toy = Toy(faults=((3, "raise"),), folder=tmp_path)
    settings = Settings(LEARNING, Collection(engine="serial"), 0)
    train.train(tmp_path / "run", toy, settings, Threads(1), Layout(10, 1, 10))
    with open(tmp_path / "run" / "failures.csv", newline="") as table:
        assert named("failures.csv") == next(csv.reader(table))


@pytest.mark.parametrize("file", ["evaluation.json", "training.json", "settings.json"])
def test_the_page_names_every_key_of_a_file(run, file):
    assert named(file) == list(json.loads((run / file).read_text()))


def test_the_page_names_every_file_of_a_run(run):
    text = PAGE.read_text()
    written = {path.name + "/" * path.is_dir() for path in run.iterdir() if not path.name.startswith(".")}
    missing = {name for name in written if f"`{name}`" not in text}
    assert not missing
    assert {"wake.csv", "wake.png", "learning-curve.png", "watch.png", "evaluation.json"} <= written
    assert [field.name for field in fields(train.Trained)] == named("training.json")[:4]
