"""The square with jets: what they blow and where, that top and bottom are mirror images, and what it was made with."""

import gymnasium
import numpy as np
import pytest

from manywake.case import task as tasks
from manywake.flow import baseline, problem
from manywake.suite import load, square_jets
from manywake.suite.square_jets import CASE, TASK


@pytest.fixture(scope="module")
def base():
    return baseline.load(load.load("square-jets").file.with_suffix(".npz"), CASE)


@pytest.fixture(scope="module")
def posed(base):
    return problem.pose(CASE, base.mesh)


def test_each_jet_of_the_square_blows_its_flow_rate_out_of_its_own_face(posed):
    space = posed.space
    for k, (name, up) in enumerate((("square.top", 1), ("square.bottom", -1))):
        flux, _ = problem.boundary_flux(space, space.facets(name), posed.profiles[k])
        assert flux == pytest.approx(1.0, abs=1e-12)
        nodes = np.flatnonzero(posed.profiles[k].any(axis=1))
        x, y = space.x[nodes].T
        assert (x > 0.4).all() and (x < 0.5).all() and (abs(y - 0.5 * up) < 1e-12).all()
        assert not posed.profiles[k][nodes, 0].any() and (up * posed.profiles[k][nodes, 1] > 0).all()


def test_the_pair_of_jets_has_no_net_flux(posed):
    amplitudes = tasks.matrix(TASK, 2) @ [0.1]
    whole = np.concatenate([posed.space.facets(name) for name in ("square", "square.top", "square.bottom")])
    flux, _ = problem.boundary_flux(posed.space, whole, np.tensordot(amplitudes, posed.profiles, 1))
    assert abs(amplitudes).max() == 0.1
    assert flux == pytest.approx(0.0, abs=1e-14)


def test_the_jets_are_mirror_images_at_nodes_that_are(posed):
    x, (top, bottom) = posed.space.x, posed.profiles
    above, below = np.flatnonzero(top.any(axis=1)), np.flatnonzero(bottom.any(axis=1))
    above, below = above[np.argsort(x[above, 0])], below[np.argsort(x[below, 0])]
    assert np.allclose(x[above] * [1, -1], x[below], atol=1e-12)
    assert np.allclose(top[above] * [1, -1], bottom[below], rtol=1e-12)


@pytest.mark.parametrize("sensor", CASE.sensors, ids=lambda sensor: sensor.name)
def test_the_64_probes_of_a_set_are_their_own_mirror_image(sensor):
    points = {(x, round(y, 9)) for x, y in sensor.points}
    assert len(points) == 64
    assert points == {(x, round(-y, 9) + 0.0) for x, y in points}


def test_full_jets_were_withstood_even_where_they_jump(base):
    assert base.withstood.held == base.withstood.smooth == 1.0
    assert base.statistics.kind == "periodic"


def test_the_reward_is_nothing_without_control_and_pays_for_power_and_lift(base):
    still = base.free | {"c_l": 0.0}
    assert square_jets.reduction(still, base.free) == 0.0
    assert square_jets.reduction(still | {"power": 0.1}, base.free) == pytest.approx(-0.1)
    assert square_jets.reduction(still | {"c_l": -0.5}, base.free) == pytest.approx(-0.1)
    steady = base.steady | {"c_l": 0.0}
    assert square_jets.power(steady, base.free) == base.free["c_d"] - base.steady["c_d"]


def test_the_square_has_an_id_of_its_own():
    with gymnasium.make("manywake/SquareJets-v0", actions=2) as env:
        observation, _ = env.reset(seed=0)
        assert observation.shape == (64 + 2,)
        _, reward, _, _, info = env.step([1.0])
        assert np.isfinite(reward) and info["power"] > 0.0
