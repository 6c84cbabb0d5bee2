"""Movies: what they show, and that filming changes nothing."""

import json
import subprocess
import sys

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from manywake import api, movie
from manywake.case.learning import Learning
from manywake.env.control import ControlledFlows, drive
from manywake.env.scene import STRIP, TITLE, WIDTH, Scene
from manywake.learn import flows
from manywake.learn.controllers import simple
from manywake.learn.settings import Collection
from manywake.suite import load

# imageio-ffmpeg leaves a pipe for the collector to close
pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
CONSTANT = simple("constant", (0.5,), 1)


@pytest.fixture(scope="module")
def simulation():
    return flows.open_flows(load.choose("cylinder-jets", actions=4))


def frames(path):
    """Return the size of a film and its pictures, (frames, height, width, 3)."""
    reader = imageio_ffmpeg.read_frames(str(path))
    width, height = next(reader)["size"]
    return np.stack([np.frombuffer(frame, np.uint8).reshape(height, width, 3) for frame in reader])


def test_a_film_shows_the_start_and_the_parts_of_every_action(simulation, tmp_path):
    made = movie.movie(simulation.flows[0], simulation.task, CONSTANT, tmp_path / "wake.mp4")
    film = frames(made.path)
    # an action takes a quarter of a convective time, of which eight pictures are shown
    assert len(film) == made.frames == 1 + 4 * 2 and not made.diverged
    assert [path.name for path in tmp_path.iterdir()] == ["wake.mp4"]
    scene = Scene(simulation.flows[0], 1.0)
    height = scene.view.height
    assert film.shape[1:] == (2 * (TITLE + height) + STRIP, WIDTH, 3)
    # uncontrolled above controlled: alike at the start, of other colours at the slots in the end
    above, below = film[:, TITLE : TITLE + height], film[:, 2 * TITLE + height : 2 * (TITLE + height)]
    ((x, y),) = scene.view.pixels(np.array([(0.0, 0.05)])).astype(int)
    slot = slice(y - 3, y + 3), slice(x - 3, x + 3)
    first, last = (np.abs(above[k][slot].astype(int) - below[k][slot]).mean() for k in (0, -1))
    assert last > 5 * first
    drawn = scene.field(simulation.flows[0].baseline.start, np.zeros(2)).astype(int)
    assert np.abs(above[0] - drawn).mean() < 4  # but for what the encoder loses


def test_a_gif_moves_for_as_long(simulation, tmp_path):
    made = movie.movie(simulation.flows[0], simulation.task, CONSTANT, tmp_path / "wake.gif")
    with Image.open(made.path) as gif:
        assert gif.size[0] == 3 * WIDTH // 4
        assert gif.n_frames == pytest.approx(made.frames / 3, abs=1)


def test_pictures_in_between_change_no_bit(simulation):
    flow, task = simulation.flows[0], simulation.task
    watched, twin = (ControlledFlows(flow, task, 2) for _ in range(2))
    seen = []
    for step in drive(twin, CONSTANT.on(twin), 3):
        outcome = watched.act(step.action, 3, seen.append)
        np.testing.assert_array_equal(outcome.reward, step.outcome.reward)
        np.testing.assert_array_equal(watched.observe(), step.after)
    assert len(seen) == 9
    np.testing.assert_array_equal(seen[-1], twin.amplitude)


def test_a_film_of_another_kind_is_refused_before_anything_is_played(simulation, tmp_path):
    with pytest.raises(ValueError, match=r"output: got '.*wake.avi', wanted a name that ends in .mp4 or .gif"):
        movie.movie(simulation.flows[0], simulation.task, CONSTANT, tmp_path / "wake.avi")
    assert not list(tmp_path.iterdir())


def test_the_command_films_a_case_and_a_run(tmp_path):
    def manywake(*words):
        return subprocess.run([sys.executable, "-m", "manywake.cli", *words], capture_output=True, text=True)

    short = ["--actions", "2", "--json"]
    done = manywake("movie", "--case", "cylinder-jets", "--pretrained", "-o", str(tmp_path / "a.gif"), *short)
    assert json.loads(done.stdout.splitlines()[-1]) == {
        "films": [str(tmp_path / "a.gif")],
        "frames": 5,
        "blew up": False,
    }
    learning, collection = Learning(update_period=2, episodes=2, batch_size=2, hidden=(8,)), Collection(engine="serial")
    api.train(learning=learning, collection=collection, run=tmp_path / "run", actions=2)
    done = manywake("movie", str(tmp_path / "run"), "-o", str(tmp_path / "b.mp4"), "--json")
    assert json.loads(done.stdout.splitlines()[-1])["frames"] == 5, done.stderr
    refused = manywake("movie", str(tmp_path / "run"), "-o", str(tmp_path / "b.avi"))
    assert refused.returncode == 2 and "wanted a name that ends in .mp4 or .gif" in " ".join(refused.stderr.split())
