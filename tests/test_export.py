"""Files for ParaView, read back: fields, geometry, times, names; and the command."""

import json
import subprocess
import sys
import xml.etree.ElementTree as etree

import meshio
import numpy as np
import pytest

import manywake
from manywake import export
from manywake.case import Circle, Polygon, Scales, replace
from manywake.cli import exports, main
from manywake.env.control import ControlledFlows
from manywake.flow import mesh as meshes
from manywake.flow import readings, space
from manywake.flow.batch import Start
from manywake.learn import flows as simulations
from manywake.learn.controllers import simple
from manywake.suite import load
from manywake.suite.cylinder_jets import CASE, TASK

from .conftest import TINY, pretended, tiny_mesh

SHORT = replace(TASK, interval=0.002, actions=4)
HERE = manywake.Collection(engine="serial")
WORDS = ["--interval", "0.002", "--actions", "4"]


def flat_mesh() -> meshes.Mesh:
    """Return the tiny mesh with straight facets."""
    return replace(tiny_mesh(), curves={})


def state(on: space.Space, u: np.ndarray) -> Start:
    p = np.sin(7 * on.mesh.points[:, 0]) + on.mesh.points[:, 1]
    return Start(u, u, p, p, p)


def manywake_(*words: str) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, "-m", "manywake.cli", *words], capture_output=True, text=True, check=False)


# ---- a frame


@pytest.mark.parametrize("mesh", [tiny_mesh(), flat_mesh()], ids=["curved", "straight"])
def test_middles_lie_between_the_vertices_that_vtk_has_them_between(mesh):
    on = space.build(mesh)
    cells = export.triangles(on)
    corners, middles = on.x[cells[:, :3]], on.x[cells[:, 3:]]
    sides = corners[:, [1, 2, 0]] - corners
    away = np.linalg.norm(middles - (corners + sides / 2), axis=2)
    assert (away <= 0.15 * np.linalg.norm(sides, axis=2)).all()  # a curved side is its arc's, not its chord's
    straight = ~np.isin(np.arange(len(cells)), on.curved)
    np.testing.assert_allclose(middles[straight], (corners + sides / 2)[straight], atol=1e-14)
    assert (np.cross(np.pad(sides[:, 0], ((0, 0), (0, 1))), np.pad(sides[:, 1], ((0, 0), (0, 1))))[:, 2] > 0).all()
    assert {frozenset(cell) for cell in cells.tolist()} == {frozenset(cell) for cell in on.nodes.tolist()}


def test_middles_of_curved_sides_lie_on_the_curve():
    on = space.build(tiny_mesh())
    frame = export.drawing(on, TINY.scales)(state(on, np.zeros_like(on.x)))
    r = np.linalg.norm(frame.points, axis=1)
    assert (r > 0.5 - 1e-12).all()  # in diameters
    assert (abs(r - 0.5) < 1e-12).sum() == 2 * sum(map(len, on.mesh.middles()[:1]))


def test_a_frame_read_back_has_the_fields_of_the_solver_in_units_of_the_scales(tmp_path):
    on, scales = space.build(tiny_mesh()), Scales(length=0.1, velocity=2.0)
    u = np.random.default_rng(1).normal(size=on.x.shape)
    now = state(on, u)
    export.drawing(on, scales)(now).write(tmp_path / "flow.vtu")
    frame = meshio.read(tmp_path / "flow.vtu")
    n, m, data = len(on.x), len(on.mesh.points), frame.point_data
    assert {name: (part.shape, part.dtype.name) for name, part in data.items()} == {
        "velocity": ((n, 3), "float32"),
        "pressure": ((n,), "float32"),
        "vorticity": ((n,), "float32"),
    }
    np.testing.assert_array_equal(frame.points, np.c_[on.x / 0.1, np.zeros(n)])
    np.testing.assert_array_equal(data["velocity"], np.c_[u / 2.0, np.zeros(n)].astype(np.float32))
    np.testing.assert_array_equal(data["pressure"][:m], (now.p / 4.0).astype(np.float32))
    (cells,) = frame.cells
    assert (cells.type, cells.data.shape) == ("triangle6", (len(on.nodes), 6))
    for middle, (a, b) in {3: (0, 1), 4: (1, 2), 5: (2, 0)}.items():
        ends = now.p[cells.data[:, a]] + now.p[cells.data[:, b]]
        np.testing.assert_allclose(data["pressure"][cells.data[:, middle]], ends / 8.0, rtol=0, atol=1e-7)


def test_solid_rotation_has_twice_its_rate_as_vorticity():
    on = space.build(tiny_mesh())
    turning = 1.5 * np.c_[-on.x[:, 1], on.x[:, 0]]
    np.testing.assert_allclose(export.vorticity(on)(turning), 3.0, rtol=1e-10)
    frame = export.drawing(on, Scales(length=0.1, velocity=2.0))(state(on, turning))
    np.testing.assert_allclose(frame.point_data["vorticity"], 3.0 * 0.1 / 2.0, rtol=1e-6)


def test_vorticity_of_a_quadratic_velocity_is_exact_on_straight_triangles():
    on = space.build(flat_mesh())
    x, y = on.x.T
    found = export.vorticity(on)(np.c_[-(y**2), 0.5 * x**2 + x * y])
    np.testing.assert_allclose(found, x + 3 * y, atol=1e-11)


def test_vorticity_of_a_smooth_flow_converges():
    errors, mesh = [], tiny_mesh()
    for _ in range(3):
        on = space.build(mesh)
        x, y = 10 * on.x.T
        found = export.vorticity(on)(np.c_[np.sin(x) * np.cos(y), -np.cos(x) * np.sin(y)])
        errors.append(np.sqrt(np.mean((found - 20 * np.sin(x) * np.sin(y)) ** 2)))
        mesh = meshes.refine(mesh)
    assert (np.log2(np.divide(errors[:-1], errors[1:])) > 1.0).all(), errors


# ---- bodies


def test_outlines_are_closed_lines_of_every_body():
    wedge = Polygon("wedge", ((0.2, -0.05), (0.28, 0.0), (0.2, 0.05)))
    case = replace(CASE, bodies=(Circle("cylinder", (0.0, 0.0), 0.05, parts=CASE.bodies[0].parts), wedge), sensors=())
    drawn = export.outlines(case)
    (lines,), (number,) = drawn.cells, drawn.cell_data["body"]
    np.testing.assert_array_equal(np.bincount(lines.data.ravel()), 2)  # each point ends one line and begins another
    np.testing.assert_allclose(np.linalg.norm(drawn.points[lines.data[number == 0]], axis=-1), 0.5)
    np.testing.assert_allclose(drawn.points[lines.data[number == 1][:, 0]][:, :2], np.array(wedge.corners) / 0.1)


# ---- an episode


def test_an_episode_leaves_a_frame_of_its_start_and_one_for_each_action(shipped, tmp_path):
    found = export.export(shipped, SHORT, simple("constant", (0.5,), 1), tmp_path)
    names = [f"flow-{k:04d}.vtu" for k in range(5)]
    assert sorted(path.name for path in tmp_path.iterdir()) == [export.BODIES, *names, "flow.pvd"]
    sets = list(etree.parse(found.collection).getroot().iter("DataSet"))
    assert [each.get("file") for each in sets] == names
    times = [float(each.get("timestep")) for each in sets]
    np.testing.assert_allclose(times, 0.02 * np.arange(5), atol=1e-9)  # L / U is 0.1
    np.testing.assert_allclose(found.times, times)
    assert not found.diverged
    start = meshio.read(tmp_path / names[0]).point_data["velocity"][:, :2]
    np.testing.assert_array_equal(start, shipped.baseline.start.u.astype(np.float32))


def test_frames_are_of_the_flow_that_the_controller_drives(shipped, tmp_path):
    driven = simple("constant", (0.5,), 1)
    export.export(shipped, SHORT, driven, tmp_path)
    flows = ControlledFlows(shipped, SHORT, 1)
    flows.reset([0], [0], shipped.baseline.start)
    for _ in range(4):
        flows.act(np.array([[0.5]]))
    last, end = meshio.read(tmp_path / "flow-0004.vtu").point_data, flows.batch.state(0)
    np.testing.assert_array_equal(last["velocity"][:, :2], end.u.astype(np.float32))
    np.testing.assert_array_equal(last["pressure"][: len(end.p)], end.p.astype(np.float32))


def test_frames_may_be_several_actions_apart_and_the_episode_of_another_length(shipped, tmp_path):
    found = export.export(shipped, SHORT, simple("none", (), 1), tmp_path, actions=5, every=2, name="free")
    assert sorted(path.name for path in tmp_path.glob("free-*")) == [f"free-{k:04d}.vtu" for k in (0, 2, 4)]
    np.testing.assert_allclose(found.times, [0.0, 0.04, 0.08])
    with pytest.raises(ValueError, match="every: got 0, wanted at least 1"):
        export.export(shipped, SHORT, simple("none", (), 1), tmp_path, every=0)


def test_a_flow_that_blows_up_has_no_more_frames(shipped, tmp_path, monkeypatch):
    monkeypatch.setattr(readings, "NO_FLOW", 0.0)
    found = export.export(shipped, SHORT, simple("none", (), 1), tmp_path)
    assert found.diverged and found.times == (0.0,)


def test_an_export_is_not_mixed_with_another(tmp_path):
    assert export.free(tmp_path / "new") == tmp_path / "new"
    (tmp_path / "flow-0000.vtu").touch()
    with pytest.raises(ValueError, match="wanted a folder without an export: -o ANOTHER"):
        export.free(tmp_path)


# ---- the commands


def test_a_case_is_exported_with_its_settings_and_a_controller(tmp_path):
    folder = tmp_path / "out"
    words = ["--controller", "constant", "--numbers", "0.5", "--json", *WORDS]
    done = manywake_("export", "--case", "cylinder-jets", "-o", str(folder), "--every", "2", *words)
    assert done.returncode == 0, done.stderr
    numbers = json.loads(done.stdout.splitlines()[-1])
    assert numbers == {
        "open in ParaView": [str(folder / "flow.pvd")],
        "frames": 3,
        "end [L/U]": pytest.approx(0.08),
        "blew up": False,
    }


def test_a_run_is_exported_with_its_newest_policy(shipped, tmp_path):
    given = {"episodes": 2, "update_period": 2, "hidden": (8,), "interval": 0.002, "actions": 3}
    run = manywake.train(run=tmp_path / "run", collection=HERE, **given)
    done = manywake_("export", str(run.folder), "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1])["frames"] == 4
    last = meshio.read(run.folder / "paraview" / "flow-0003.vtu").point_data["velocity"][:, :2]
    flows = ControlledFlows(shipped, run.simulation.task, 1)
    flows.reset([0], [0], shipped.baseline.start)
    policy = manywake.load_policy(run.folder)
    for _ in range(3):
        flows.act(policy(flows.observe()))
    np.testing.assert_allclose(last, flows.batch.state(0).u, rtol=0, atol=1e-6)


def test_a_run_of_another_simulation_has_no_fields_to_export(tmp_path):
    given = {"episodes": 2, "update_period": 2, "batch_size": 400, "hidden": (8,)}
    run = manywake.train(env="Pendulum-v1", run=tmp_path / "run", collection=HERE, **given)
    with pytest.raises(ValueError, match="wanted one of a flow"):
        exports.Export(run.folder, env="Pendulum-v1").run()


def test_each_of_several_reynolds_numbers_has_frames_of_its_own(base, tmp_path, capsys):
    task = replace(SHORT, actions=2, reynolds_numbers=(90.0, 100.0))
    with pretended(tmp_path / "cache", base, replace(CASE, reynolds=90.0)):
        simulation = simulations.open_flows(load.choose("cylinder-jets", task))
    exports._written(simulation, simple("none", (), 1), tmp_path / "out", None, 2, True)
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["frames"] == 4
    names = {f"flow-{re}{tail}" for re in (90, 100) for tail in (".pvd", "-0000.vtu", "-0002.vtu")}
    assert {path.name for path in (tmp_path / "out").iterdir()} == names | {export.BODIES}


@pytest.mark.parametrize(
    ("words", "case"),
    [
        ("export --case cylinder-jets", True),
        ("export --case=mine.py --reynolds 80 -o out", True),
        ("export --pretrained", True),
        ("export --controller none", True),
        ("export runs/one", False),
        ("export runs/one --case mine.py -o out", False),
        ("export --help", False),
        ("evaluate runs/one --case mine.py", False),
        ("evaluate --case mine.py --controller none", True),
        ("train --case mine.py", False),
    ],
)
def test_the_words_tell_a_run_from_a_case(words, case):
    assert main._of_no_run(words.split()) == case
