"""Pictures of flows: fields at pixels against the finite elements, and what is drawn over them."""

from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from manywake import FlowEnv, FlowVectorEnv
from manywake.env.scene import STRIP, WIDTH, Scene
from manywake.flow import raster
from manywake.flow.mesh import Mesh
from manywake.flow.raster import Raster, View
from manywake.suite import square_jets

SHORT = {"interval": 0.005, "actions": 3}
VIEW = View((-0.1, 0.3), (-0.15, 0.15), 80, 60)


@pytest.fixture(scope="module")
def pixels(ops):
    return Raster(ops.space, VIEW)


@pytest.fixture(scope="module")
def scene(shipped):
    return Scene(shipped, duration=4.0)


def within(pixels):
    """Return the places (k, 2) of the pixels in the fluid."""
    return VIEW.centres()[pixels.fluid.ravel()]


def test_pixels_of_the_body_are_no_fluid(pixels):
    away = np.linalg.norm(VIEW.centres(), axis=1).reshape(pixels.fluid.shape)
    assert not pixels.fluid[away < 0.049].any() and pixels.fluid[away > 0.051].all()


def test_a_linear_vorticity_is_drawn_exactly(ops, base, pixels):
    x, y = ops.space.x.T
    state = replace(base.start, u=np.stack([y * y + x * y, 3 * x * x - y], axis=1))
    at = within(pixels)
    assert pixels.vorticity(state)[pixels.fluid] == pytest.approx(5 * at[:, 0] - 2 * at[:, 1], abs=2e-4)


def test_a_picture_shows_the_bodies_with_room_around_them_and_no_more():
    wide = Mesh(np.array([(-20.0, -20.0), (40.0, 20.0)]), np.empty((0, 3), int), {})
    view = raster.framed(square_jets.CASE, wide, 640)
    assert view.x == (-3.0, 16.0) and view.y == (-5.5, 5.5)
    assert view.height % 2 == 0 and view.height == pytest.approx(640 * 11 / 19, abs=1)


def test_up_is_up_and_blowing_changes_the_slot_alone(scene, base):
    still, blowing = (scene.frame(base.start, np.array([a, 0.0]), []) for a in (0.0, 1.0))
    changed = np.argwhere((still != blowing).any(axis=2))
    low, high = scene.view.pixels(np.array([(-0.02, 0.03), (0.02, 0.07)]))
    assert len(changed)
    assert (changed[:, 0] > high[1]).all() and (changed[:, 0] < low[1]).all()
    assert (changed[:, 1] > low[0]).all() and (changed[:, 1] < high[0]).all()


def test_clockwise_and_counter_clockwise_vorticity_have_colours_of_their_own(scene, ops, base):
    x, y = ops.space.x.T
    turning = [replace(base.start, u=sign * 15 * np.stack([-y, x], axis=1)) for sign in (1, -1)]
    red, blue = (scene.frame(state, np.zeros(2), [])[5, 600].astype(int) for state in turning)
    assert red[0] > red[2] + 50 and blue[2] > blue[0] + 50


def test_traces_below_grow_with_time(scene, base):
    def ink(count):
        traces = [(0.05 * k, 3.2, 0.1) for k in range(1, count + 1)]
        strip = scene.frame(base.start, np.zeros(2), traces)[-STRIP:, : WIDTH // 2]
        return int((np.abs(strip.astype(int) - (47, 108, 159)).sum(axis=2) < 60)[25:].sum())

    assert 0 == ink(0) < ink(20) < ink(60)


def test_a_flow_that_blew_up_is_drawn_all_the_same(scene, base):
    gone = replace(base.start, u=np.full_like(base.start.u, np.nan))
    with np.errstate(invalid="ignore"):
        assert scene.frame(gone, np.zeros(2), [(0.1, np.nan, np.nan)]).dtype == np.uint8


def test_gymnasiums_checker_is_content_with_the_pictures():
    env = gymnasium.make("manywake/CylinderJets-v0", render_mode="rgb_array", **SHORT)
    check_env(env.unwrapped)


def test_a_batch_gives_a_picture_of_each_flow_that_its_single_environment_gives_too():
    batch = FlowVectorEnv(2, render_mode="rgb_array", **SHORT)
    single = FlowEnv(render_mode="rgb_array", **SHORT)
    batch.reset(seed=4)
    single.reset(seed=5)
    for action in (1.0, -1.0):
        batch.step(np.full((2, 1), action))
        single.step(np.array([action]))
    first, second = batch.render()
    np.testing.assert_array_equal(second, single.render())
    assert first.shape == second.shape and first.shape[1:] == (WIDTH, 3)


def test_without_a_mode_nothing_is_drawn():
    env = FlowEnv(**SHORT)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="render: got no render_mode, wanted render_mode='rgb_array' or 'human'"):
        env.render()
    with pytest.raises(ValueError, match="render_mode: got 'ansi', wanted None or one of rgb_array, human"):
        FlowEnv(render_mode="ansi", **SHORT)


@pytest.mark.filterwarnings("ignore")  # of pygame's own imports
def test_a_window_follows_the_flow(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    import pygame

    env, twin = (FlowEnv(render_mode=mode, **SHORT) for mode in ("human", "rgb_array"))
    for each in (env, twin):
        each.reset(seed=0)
        each.step(np.array([1.0]))
    assert env.render() is None
    shown = pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1)
    np.testing.assert_array_equal(shown, twin.render())
    env.close()
    assert pygame.display.get_surface() is None


@pytest.mark.filterwarnings("ignore")  # of moviepy's own imports, and that the folder is new
def test_gymnasium_records_a_video(tmp_path):
    env = gymnasium.make("manywake/CylinderJets-v0", render_mode="rgb_array", **SHORT)
    env = gymnasium.wrappers.RecordVideo(env, str(tmp_path), disable_logger=True)
    env.reset(seed=0)
    for _ in range(3):
        env.step(np.zeros(1))
    env.close()
    (video,) = tmp_path.glob("*.mp4")
    assert video.stat().st_size > 1000
