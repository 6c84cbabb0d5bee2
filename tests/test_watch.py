"""A picture of a training under way changes no bit of it."""

import pytest
import tyro

from manywake.cli.runs import Resume
from manywake.learn import train, watch
from manywake.learn.blocks import Layout
from manywake.learn.engine import Threads
from manywake.learn.settings import Collection, Settings
from manywake.learn.watch import NAME, Watch

from .toy import LEARNING, Toy

pytestmark = pytest.mark.alone

SETTINGS = Settings(LEARNING, Collection(engine="serial"), 0)


def trained(folder, show=train.quiet) -> str:
    return train.train(folder, Toy(terminate_every=7), SETTINGS, Threads(1), Layout(10, 1, 10), show).policy_sha256


def test_a_training_that_is_watched_learns_the_same_to_the_bit(tmp_path, monkeypatch):
    pictures, draw = [], Watch._draw
    monkeypatch.setattr(Watch, "_draw", lambda self, newest: (pictures.append(newest), draw(self, newest)))
    with Watch(tmp_path / "a", 100) as watching:
        watched = trained(tmp_path / "a", watching.show)
    assert watched == trained(tmp_path / "b")
    assert watching.problem is None
    assert (tmp_path / "a" / NAME).read_bytes().startswith(b"\x89PNG")
    assert not any(episode.terminated for episode in pictures)
    assert 1 <= len(pictures) <= 3  # no more often than every five seconds, and once at the end
    assert not list((tmp_path / "a").glob("*.partial"))


def test_what_came_last_is_drawn_at_the_end_and_nothing_where_nothing_came(tmp_path):
    with Watch(tmp_path, 100):
        pass
    assert not (tmp_path / NAME).exists()


def test_a_picture_that_fails_ends_no_training(tmp_path, monkeypatch):
    def fail(*arguments):
        raise OSError("no space left on device")

    monkeypatch.setattr(watch.Watch, "_draw", fail)
    with Watch(tmp_path / "a", 100) as watching:
        trained(tmp_path / "a", watching.show)
    assert "no space" in str(watching.problem)
    assert not (tmp_path / "a" / NAME).exists()


def test_a_training_that_goes_on_can_be_watched_too():
    assert tyro.cli(Resume, args=["runs/a", "--watch"]).watch is True
    assert tyro.cli(Resume, args=["runs/a"]).watch is False
