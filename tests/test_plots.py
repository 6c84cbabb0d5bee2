"""Pictures: what is drawn is what is there, and nothing that the eye would add."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from manywake import plots
from manywake.learn import evaluate, tables
from manywake.learn.evaluate import Trajectory
from manywake.suite.cylinder_jets import CASE


@pytest.fixture
def drawn(monkeypatch) -> list[Figure]:
    """Return the figures that were drawn, which are then not written."""
    figures: list[Figure] = []
    monkeypatch.setattr(plots, "_save", lambda figure, path: figures.append(figure))
    return figures


def record(steps: int = 400) -> dict[str, np.ndarray]:
    """A record whose lift jumps at first, and is calm from then on."""
    lift = np.where(np.arange(steps) < steps // 20, 30.0, 0.1)[:, None]
    series = {"c_d": np.full((steps, 1), 3.0), "c_l": lift}
    whole = Trajectory(series, np.zeros((steps, 2, 1)), np.zeros((8, 1)), [])
    free = {"c_d": np.full((steps, 1), 3.2), "c_l": np.sin(np.arange(steps))[:, None]}
    return evaluate.record(CASE, ("c_d", "c_l"), whole, free)


def test_a_mesh_is_drawn_whole_and_at_its_bodies_with_all_that_acts_and_measures(shipped, drawn, tmp_path):
    plots.mesh(CASE, shipped.baseline.mesh, "a case", tmp_path / "mesh.png")
    (figure,) = drawn
    whole, near = figure.get_axes()
    assert [*whole.get_xlim(), *whole.get_ylim()] == pytest.approx([-0.2, 2.0, -0.2, 0.21])
    assert [*near.get_xlim(), *near.get_ylim()] == pytest.approx([-0.1, 0.1, -0.1, 0.1])
    named = [text.get_text() for text in whole.get_legend().get_texts()]
    assert named == ["Jet cylinder.top", "Jet cylinder.bottom", "pressure", "velocity"]
    sides = {len(line.get_xdata()) for line in near.get_lines()}
    assert len(CASE.sensors[0].points) in sides and max(sides) >= 3 * len(shipped.baseline.mesh.triangles) // 2


def test_the_wake_is_drawn_in_diameters_and_its_title_has_reynolds_number_and_time(shipped, drawn, tmp_path):
    start = shipped.baseline.start
    plots.wake(shipped, start, start, record(), "a case, seed 3, Re 100", tmp_path / "wake.png")
    (figure,) = drawn
    fields = [axis for axis in figure.get_axes() if any(isinstance(one, AxesImage) for one in axis.get_children())][:2]
    assert [axis.get_xlim() for axis in fields] == [(pytest.approx(-2.0), pytest.approx(16.0))] * 2
    assert [axis.get_xlabel() for axis in fields] == ["x/D"] * 2
    assert figure.get_suptitle() == "a case, seed 3, Re 100, 4 L/U after control began"


def test_a_jump_at_first_does_not_decide_the_range_of_the_lift(shipped, drawn, tmp_path):
    start = shipped.baseline.start
    plots.wake(shipped, start, start, record(), "", tmp_path / "wake.png")
    (lift,) = [axis for axis in drawn[0].get_axes() if axis.get_ylabel() == "$C_L$"]
    assert -1.5 < lift.get_ylim()[0] < lift.get_ylim()[1] < 1.5
    assert lift.get_title(loc="left") == "at first from 0.10 to 30.00"


def test_a_dashed_line_is_the_steady_flow_in_every_picture(shipped, drawn, tmp_path):
    start, base, path = shipped.baseline.start, shipped.baseline, tmp_path / "x.png"
    numbers = {f"{name}_second_half": np.arange(4.0) for name in ("c_d", "c_l")} | {"reward": np.arange(4.0)}
    table = numbers | {"update": np.arange(4.0) // 2, "episode": np.arange(4), "wall_s": np.arange(4.0)}
    plots.wake(shipped, start, start, record(), "", path)
    plots.learning_curve(table, base, "", path)
    plots.compare([("A", [(np.arange(2), np.arange(2))])], "", {"steady flow": 2.9, "uncontrolled, mean": 3.2}, path)
    plots.watch(table, {"c_d": np.ones(3), "c_l": np.ones(3)}, "", path)
    dashed = [
        [line for axis in figure.get_axes() for line in axis.get_lines() if line.get_ls() == "--"] for figure in drawn
    ]
    assert [len(lines) for lines in dashed] == [2, 4, 1, 0]
    assert {line.get_label() for lines in dashed for line in lines} == {"steady flow"}


def test_groups_of_many_runs_have_a_colour_each(drawn, tmp_path):
    curve = np.arange(3), np.arange(3)
    for count in (2, 12):
        plots.compare([(str(k), [curve, curve]) for k in range(count)], "", {}, tmp_path / "x.png")
        lines = drawn.pop().get_axes()[0].get_lines()
        assert len(lines) == 3 * count and len({str(line.get_color()) for line in lines}) == count


def test_means_of_updates_leave_out_episodes_that_blew_up():
    table = {"update": np.array([0, 0, 1, 1]), "episode": np.array([1, 0, 2, 3]), "x": np.array([2, 4, np.nan, 5.0])}
    episodes, means = plots.update_means(table | {"y": np.array([1, 1, np.nan, np.nan])}, "x")
    np.testing.assert_array_equal(episodes, [2, 4])
    np.testing.assert_array_equal(means, [3, 5])
    assert np.isnan(plots.update_means({**table, "x": np.full(4, np.nan)}, "x")[1]).all()


def test_a_flow_that_blew_up_is_drawn_too(shipped, drawn, tmp_path):
    start, broken = shipped.baseline.start, record()
    broken["c_l"][30:] = np.nan
    broken["c_d"][:] = np.nan
    plots.wake(shipped, start, replace(start, u=np.full_like(start.u, np.nan)), broken, "", tmp_path / "wake.png")
    assert len(drawn) == 1


def test_the_series_behind_the_wake_come_back_from_their_file(tmp_path):
    table = record()
    evaluate._write(table, tmp_path / "wake.csv")
    found = tables.columns(tmp_path / "wake.csv")
    assert list(found) == list(table)
    for name, column in table.items():
        np.testing.assert_allclose(found[name], column, rtol=1e-6, atol=1e-12)
    assert found["time"][0] == pytest.approx(CASE.dt / CASE.convective_time)
    coarse = replace(CASE, time_step=5e-4)
    assert evaluate.record(coarse, (), Trajectory({}, np.zeros((2, 2, 1)), np.zeros(1), []), {})["time"][0] == 0.005
