"""A flow of the user's own works like a shipped one: the files of the pages as written, from both doors."""

import json
import os
import re
import runpy
import shutil
import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import manywake
from manywake.case.geometry import Circle, Polygon, Smooth
from manywake.flow import baseline, spinup, stability, store
from manywake.flow import mesh as meshes
from manywake.flow import space as spaces
from manywake.flow.mesh import Mesh
from manywake.learn import tables
from manywake.learn.settings import Collection
from manywake.machine import compile
from manywake.suite import load

PAGES = [Path(__file__).parents[1] / "docs" / name for name in ("tutorial.md", "own-flow.md")]
EXAMPLES = Path(__file__).parents[1] / "examples" / "own_flow"
BRIEF = {"spin_up": 60.0, "actions": 2}
SMALL = ["--episodes", "2", "--update-period", "2", "--hidden", "8", "--spin-up", "60", "--actions", "2"]


def blocks() -> dict[str, str]:
    """The files of the pages by their names."""
    text = "".join(page.read_text() for page in PAGES)
    return dict(re.findall(r"```python\n# (\w+\.py)\n(.*?)```", text, re.DOTALL))


def command(folder: Path, *words: str) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, "-m", "manywake.cli", *words], cwd=folder, capture_output=True, text=True, check=False
    )


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """A folder with the pages' files, and a cache of its own."""
    folder = tmp_path_factory.mktemp("own")
    for name, text in blocks().items():
        (folder / name).write_text(text)
    before = os.environ.get("XDG_CACHE_HOME")
    kernels = os.environ.get("NUMBA_CACHE_DIR")
    os.environ["XDG_CACHE_HOME"] = str(folder / "cache")
    os.environ["NUMBA_CACHE_DIR"] = kernels or compile._cache_folder()  # kernels need not be compiled anew
    yield folder
    for name, value in (("XDG_CACHE_HOME", before), ("NUMBA_CACHE_DIR", kernels)):
        if value is None:
            del os.environ[name]
        else:
            os.environ[name] = value


def test_the_pages_have_files_of_at_most_forty_lines():
    assert {"turning.py", "gentle.py", "slower.py", "side_by_side.py"} <= set(blocks())
    assert all(len(text.splitlines()) <= 40 for text in blocks().values())


def test_the_page_s_flow_of_a_new_geometry_is_the_example():
    assert blocks()["side_by_side.py"] == (EXAMPLES / "side_by_side.py").read_text()


def test_the_shipped_case_is_a_file_of_at_most_eighty_lines():
    file = load.load("cylinder-jets").file
    assert len(file.read_text().splitlines()) <= 80


def test_a_baseline_is_made_by_the_recipe_on_the_shipped_mesh(page):
    """The slowest of this file, as it spins a flow up; those that follow find what it made in the cache."""
    done = command(page, "baseline", "--case", "turning.py", "--spin-up", "60", "--json")
    assert done.returncode == 0, done.stderr
    described = json.loads(done.stdout.splitlines()[-1])
    assert (described["triangles"], described["kind"], described["start states"]) == (3695, "periodic", 4)
    # uncontrolled it is the flow of the jets' cylinder, whatever drives it
    theirs = store.get(load.load("cylinder-jets").case).statistics
    assert described["c_d mean"] == pytest.approx(theirs["c_d"].mean, rel=1e-3)
    assert described["c_l rms"] == pytest.approx(theirs["c_l"].rms, rel=5e-3)
    assert described["period"] == pytest.approx(theirs.period, rel=1e-3)
    assert described["cylinder withstood, held"] == 10.0


def test_the_page_s_commands_work_on_the_page_s_file(page):
    run = page / "run"
    done = command(page, "train", "--case", "turning.py", "--run", str(run), "--json", *SMALL)
    assert done.returncode == 0, done.stderr
    assert "drag_reduction" in json.loads(done.stdout.splitlines()[-1])
    assert (run / "case.py").read_text() == blocks()["turning.py"]
    refused = command(page, "evaluate", str(run))
    assert refused.returncode == 2 and "give it again: --case FILE" in " ".join(refused.stderr.split())
    again = command(page, "evaluate", str(run), "--case", "turning.py", "--json")
    assert again.returncode == 0, again.stderr
    shown = command(page, "train", "--case", "turning.py", "--help")
    text = " ".join(shown.stdout.replace("│", " ").split())
    assert "--limit.cylinder FLOAT" in text and "(angular velocity, counter-clockwise positive)" in text


def test_the_same_file_is_a_gymnasium_environment(page):
    env = gymnasium.make("manywake/Flow-v0", case=str(page / "turning.py"), **BRIEF)
    observation, _ = env.reset(seed=0)
    assert observation.shape == (41,)  # 20 points, two components, and the amplitude
    _, _, _, _, info = env.step(np.array([1.0], np.float32))
    assert 0 < info["amplitudes"][0] <= 10
    assert info["c_m"] < 0 < info["power"]  # the fluid brakes what turns it


def test_training_from_python_is_the_training_of_the_command(page, tmp_path):
    learning = manywake.Learning(update_period=2, episodes=2, hidden=(8,))
    run = manywake.train(
        page / "turning.py", learning=learning, collection=Collection(engine="serial"), run=tmp_path / "run", **BRIEF
    )
    done = command(page, "train", "--case", "turning.py", "--run", str(tmp_path / "twin"), "--json", *SMALL)
    assert done.returncode == 0, done.stderr
    both = run.folder, tmp_path / "twin"
    kept = [json.loads((folder / "settings.json").read_text())["kept"] for folder in both]
    assert kept[0] == kept[1]
    rows = [tables.untimed(tables.read(folder / "episodes.csv")) for folder in both]
    assert rows[0] == rows[1]
    again = manywake.load_run(run.folder, page / "turning.py")
    assert manywake.evaluate(again).summary() == manywake.evaluate(run).summary()


def test_a_case_made_in_python_is_opened_with_its_objects_only(tmp_path):
    chosen = load.choose("cylinder-jets", actions=2)
    learning = manywake.Learning(update_period=2, episodes=2, hidden=(8,))
    how = Collection(engine="serial")
    run = manywake.train(chosen.case, chosen.task, learning=learning, collection=how, run=tmp_path / "run")
    with pytest.raises(ValueError, match=r"made in Python.*give it again"):
        manywake.load_run(run.folder)
    with pytest.raises(ValueError, match="the task of 'python' are not those"):
        manywake.load_run(run.folder, chosen.case, load.choose("cylinder-jets", actions=3).task)
    assert manywake.load_run(run.folder, chosen.case, chosen.task).simulation.horizon == 2


def test_a_process_keeps_a_bounded_number_of_flows():
    case = load.load("cylinder-jets").case
    for points in (((0.3, 0.0),), ((0.3, 0.1),), ((0.3, -0.1),)):
        store.flow(load.choose("cylinder-jets", **{"points.pressure": points}).case)
    assert len(store._flows) == store.KEPT
    assert store.flow(case).case == case


# ---- curves by data


def fan(body, pieces: int = 24) -> Mesh:
    """A ring of triangles around a body, its facets named after its pieces."""
    names, ends = [], []
    for piece in body.pieces():
        cuts = np.linspace(piece.start, piece.end, pieces + 1)
        names += [piece.name] * pieces
        ends += cuts[:-1].tolist()
    inner, outer = body.point(np.array(ends)), 2.0 * body.point(np.array(ends))
    n = len(inner)
    k, after = np.arange(n), (np.arange(n) + 1) % n
    triangles = np.concatenate([np.c_[k, k + n, after], np.c_[after, k + n, after + n]])
    facets = {name: np.c_[k, after][np.array(names) == name] for name in names}
    facets["far"] = np.c_[k + n, after + n]
    curves = {name: body for name in facets if name != "far"}
    return Mesh(np.concatenate([inner, outer]), triangles, facets, curves)


def ellipse(angle):
    return np.stack([np.cos(angle), 0.5 * np.sin(angle)], axis=1)


SQUARE = Polygon("cylinder", ((-0.5, -0.5), (0.5, -0.5, "base"), (0.5, 0.5), (-0.5, 0.5)))


@pytest.mark.parametrize(
    ("body", "area"),
    [
        (Circle("cylinder", (0.3, -0.1), 0.5, parts={"top": (80, 100)}), np.pi / 4),
        (Smooth("ellipse", ellipse, parts={"rear": (-20, 20)}), np.pi / 2),
        (SQUARE, 1.0),
    ],
    ids=["circle", "function", "square"],
)
def test_refining_goes_on_to_the_curve_and_encloses_its_area(body, area):
    mesh, errors = fan(body), []
    for _ in range(3):
        space = spaces.build(mesh)
        basis = space.velocity.boundary(facets=np.concatenate([space.facets(name) for name in mesh.curves]))
        x, n = np.asarray(basis.global_coordinates()), basis.normals
        errors.append(abs(-0.5 * np.sum((x * n).sum(axis=0) * basis.dx) - area))
        mesh = meshes.refine(mesh)
    if body.straight:
        assert max(errors) < 1e-14
    else:
        assert (np.log2(np.divide(errors[:-1], errors[1:])) > 3.7).all()


def test_a_square_called_cylinder_is_not_bent():
    mesh = fan(SQUARE)
    assert len(spaces.build(mesh).curved) == 0
    on = np.unique(np.concatenate([mesh.boundaries[name] for name in mesh.curves]))
    np.testing.assert_allclose(abs(meshes.refine(mesh).points[on]).max(axis=1), 0.5)


def test_a_curve_s_chart_measures_arc_length_and_points_outwards():
    body = Smooth("ellipse", ellipse, parts={"rear": (-20, 20)})
    (piece,) = (piece for piece in body.pieces() if piece.name == "ellipse.rear")
    ends, middle = body.point(np.array([-20.0, 20.0])), body.point(np.array([0.0]))
    chart = body.chart(piece, np.concatenate([ends, middle]))
    np.testing.assert_allclose(chart.offset, [-0.5 * chart.length, 0.5 * chart.length, 0.0], atol=1e-9)
    fine = ellipse(np.radians(np.linspace(-20, 20, 100_001)))
    assert chart.length == pytest.approx(np.linalg.norm(np.diff(fine, axis=0), axis=1).sum(), rel=1e-6)
    np.testing.assert_allclose(chart.outward[2], [1.0, 0.0], atol=1e-6)


# ---- the examples


SIDES = {"bottom", "right", "top", "left"}
FLOWS = {
    "side_by_side.py": ({"upper", "lower"}, 32 * 20 - 2 * np.pi / 4),
    "ellipse.py": ({"ellipse", "ellipse.top", "ellipse.bottom"}, 28 * 16 - np.pi / 8),
    "polygon.py": ({"wedge", "wedge.jet"}, 28 * 16 - 0.75 / 2),
    "own_mesh/ground.py": ({"cylinder", "cylinder.top", "cylinder.bottom"}, 28 * 9.5 - np.pi / 4),
}
"""The examples, the pieces of their bodies, and the areas of the fluid."""
COARSE = {
    "sizes.body": 0.2,
    "sizes.part_facets": 2,
    "sizes.layers": 2,
    "sizes.layer_height": 0.06,
    "sizes.wake": 0.8,
    "sizes.far": 3.0,
}


@pytest.fixture
def examples(tmp_path, monkeypatch):
    """Return a folder with the examples, a cache beside them, and a recipe too short to settle anything."""
    gmsh = pytest.importorskip("gmsh", exc_type=(ImportError, OSError))
    monkeypatch.setenv("NUMBA_CACHE_DIR", os.environ.get("NUMBA_CACHE_DIR") or compile._cache_folder())
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    hasty = {
        spinup: {"BLOCK": 1.0, "MOST": 1.0},
        baseline: {"AVERAGED": 1.0, "LATER": 1.0},
        stability: {"MEASURED": 0.25, "TRIED": 0.25, "STAYING": 0.25, "PERIODS": (1,), "RESONANT": (1,), "PHASES": 1},
    }
    for module, constants in hasty.items():
        for name, value in constants.items():
            monkeypatch.setattr(module, name, value)
    folder = Path(shutil.copytree(EXAMPLES, tmp_path / "examples", ignore=shutil.ignore_patterns("*.msh")))
    assert not gmsh.isInitialized()
    return folder


def mesh_of_the_ground(folder: Path, **sizes: float) -> None:
    write = runpy.run_path(str(folder / "own_mesh" / "make_mesh.py"))["write"]
    write(folder / "own_mesh" / "ground.msh", **sizes)


@pytest.mark.parametrize("name", FLOWS)
def test_an_example_is_meshed_as_its_file_says(name, examples):
    pieces, area = FLOWS[name]
    mesh_of_the_ground(examples)
    mesh = meshes.build(load.load(examples / name).case)
    assert set(mesh.boundaries) == SIDES | pieces
    assert 3000 < len(mesh.triangles) < 9000
    assert spaces.build(mesh).velocity.dx.sum() == pytest.approx(area, rel=1e-7)


@pytest.mark.parametrize("name", FLOWS)
def test_an_example_is_trained_and_pictured(name, examples, tmp_path):
    mesh_of_the_ground(examples, finest=0.2, wake=0.8, coarsest=3.0)
    coarse = {} if name.startswith("own_mesh") else COARSE
    learning = manywake.Learning(update_period=2, episodes=2, hidden=(4,))
    settings = {"learning": learning, "collection": Collection(engine="serial"), "spin_up": 1.0, "actions": 2}
    run = manywake.train(examples / name, run=tmp_path / "run", **settings, **coarse)
    rows = tables.read(run.folder / "episodes.csv")
    assert len(rows) == 2 and np.isfinite([float(row["reward"]) for row in rows]).all()
    manywake.evaluate(run).draw(run.folder, "")
    assert (run.folder / "wake.png").stat().st_size > 10_000
    if not coarse:  # the copy finds the mesh beside it
        assert load.load(run.folder / "case.py").case == load.load(examples / name).case


def test_the_example_says_how_its_mesh_is_made_before_there_is_one(examples):
    with pytest.raises(ValueError, match=r"ground.py, line \d+, fails .*ground.msh', which is no file.*; make it"):
        load.load(examples / "own_mesh" / "ground.py")
