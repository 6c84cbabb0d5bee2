"""A mesh of the user's own, a .msh file: it is read as it was written, or refused with its place and a remedy."""

import shutil
import sys
from dataclasses import replace
from pathlib import Path

import meshio
import numpy as np
import pytest

from manywake.case import Box, Circle, Msh, Sizes, describe
from manywake.flow import mesh as meshes
from manywake.flow import space as spaces
from manywake.flow.mesh import Mesh
from manywake.suite import cylinder_jets, load

from .conftest import TINY, in_singles, tiny_mesh


def written(path: Path, mesh: Mesh, version: str = "gmsh22", kind: str = "triangle", **others) -> Path:
    """Write a mesh as gmsh would, its facets in physical groups. others: more groups of lines."""
    groups = mesh.boundaries | others
    cells = [("line", facets) for facets in groups.values()] + [(kind, mesh.triangles)]
    tags = [np.full(len(block), k + 1) for k, (_, block) in enumerate(cells)]
    names = {name: np.array([k + 1, 1]) for k, name in enumerate(groups)} | {"fluid": np.array([len(cells), 2])}
    points = np.pad(mesh.points, ((0, 0), (0, 3 - mesh.points.shape[1])))
    data = {"gmsh:physical": tags, "gmsh:geometrical": tags}
    meshio.write(path, meshio.Mesh(points, cells, cell_data=data, field_data=names), version, binary=False)
    return path


def own(path: Path, **changes):
    return replace(TINY, mesh=Msh(path), **{"sizes": Sizes()} | changes)


def test_a_mesh_that_was_written_has_the_operators_of_the_one_in_memory(tmp_path, tiny):
    read = meshes.build(own(written(tmp_path / "tiny.msh", tiny_mesh())))
    assert set(read.curves) == {"cylinder", "cylinder.top", "cylinder.bottom"}
    assert in_singles(TINY, read).digest == tiny.digest


def test_clockwise_triangles_are_turned_and_unused_points_dropped(tmp_path):
    mesh = tiny_mesh()
    points = np.concatenate([[[9.0, 9.0]], mesh.points])
    boundaries = {name: facets + 1 for name, facets in mesh.boundaries.items()}
    clockwise = replace(mesh, points=points, triangles=mesh.triangles[:, ::-1] + 1, boundaries=boundaries)
    read = meshes.build(own(written(tmp_path / "tiny.msh", clockwise)))
    np.testing.assert_array_equal(read.points, mesh.points)
    a, b, c = read.points[read.triangles].transpose(1, 0, 2)
    assert (np.linalg.det(np.stack([b - a, c - a], axis=1)) > 0).all()
    for name, facets in mesh.boundaries.items():
        np.testing.assert_array_equal(read.boundaries[name], facets)


def test_points_that_a_file_rounds_are_put_on_the_sides(tmp_path):
    mesh = tiny_mesh()
    noise = np.random.default_rng(0).uniform(-4e-7, 4e-7, mesh.points.shape)
    read = meshes.build(own(written(tmp_path / "tiny.msh", replace(mesh, points=mesh.points + noise))))
    sides = {"left": (0, -0.2), "right": (0, 0.5), "bottom": (1, -0.2), "top": (1, 0.21)}
    for name, (axis, at) in sides.items():
        np.testing.assert_allclose(read.points[read.boundaries[name]][..., axis], at, rtol=1e-14)


def test_the_content_of_the_file_counts_and_its_path_does_not(tmp_path):
    first = own(written(tmp_path / "tiny.msh", tiny_mesh()))
    moved = own(Path(shutil.copy(tmp_path / "tiny.msh", tmp_path / "moved.msh")))
    other = own(written(tmp_path / "other.msh", tiny_mesh(layers=5)))
    assert first == moved != other
    for digest in (describe.flow_digest, describe.geometry_digest):
        assert digest(first) == digest(moved)
        assert len({digest(first), digest(other), digest(TINY)}) == 3
    assert "mesh" not in describe.case(TINY)


def test_a_mesh_has_no_sizes_to_set(tmp_path):
    case = own(written(tmp_path / "tiny.msh", tiny_mesh()), sizes=Sizes())
    assert not [name for name in load.case_settings(case) if name.startswith("sizes")]
    with pytest.raises(ValueError, match="sizes: got some beside a mesh .*wanted one of the two"):
        replace(case, sizes=Sizes(far=2.0))


# ---- what is refused


def without(mesh: Mesh, name: str, count: int | None = None) -> dict:
    boundaries = dict(mesh.boundaries)
    boundaries[name] = boundaries[name][count:] if count else boundaries[name][:0]
    return {"boundaries": boundaries}


MESH = tiny_mesh()
INSIDE = MESH.triangles[:1, 1:]
BENT = MESH.points * [1.0, np.array(1.0)] + np.where(np.arange(len(MESH.points))[:, None] == 1, 0.001, 0.0)
FLAT = np.concatenate([MESH.triangles, [[0, 1, 1]]])
THRICE = np.concatenate([MESH.triangles, [[*MESH.triangles[40, :2], 70]]])
REFUSED = {
    "a name that is missing": (
        without(MESH, "cylinder.top"),
        {},
        r"groups of lines named .*cylinder.*, wanted cylinder.top too; in gmsh: addPhysicalGroup\(1, curves, name='cyl",
    ),
    "a name that the case has not": ({}, {"jet": INSIDE}, "of which the case has no jet; wanted bottom, right, top, "),
    "a facet in no group": (without(MESH, "left", 1), {}, r"facet of the boundary in no group, at \(-0.2, .*exactly"),
    "a facet in two groups": (
        {"boundaries": MESH.boundaries | {"top": np.concatenate([MESH.boundaries[n] for n in ("top", "left")])}},
        {},
        r"in the groups top, left, at \(-0.2, .*; give its curve to one physical group",
    ),
    "a line in the fluid": (
        {"boundaries": MESH.boundaries | {"left": np.concatenate([MESH.boundaries["left"], INSIDE])}},
        {},
        r"line of the group 'left' at \(.*no boundary of the triangles.*; cut the bodies out",
    ),
    "a body that is elsewhere": (
        {"points": BENT},
        {},
        "facet of 'cylinder.*' at .* off, wanted at most 1e-05; the case",
    ),
    "a triangle without area": ({"triangles": FLAT}, {}, "triangle without area at .*, wanted none"),
    "three triangles on an edge": ({"triangles": THRICE}, {}, "more than two triangles on the edge at .*, wanted two"),
    "points off the plane": (
        {"points": np.pad(MESH.points, ((0, 0), (0, 1))) + [0, 0, 1.0] * (np.arange(len(MESH.points)) > 9)[:, None]},
        {},
        "points of different z, wanted all in the plane z = 0",
    ),
    "quadrilaterals": (
        {"triangles": np.pad(MESH.triangles, ((0, 0), (0, 1)))},
        {"kind": "quad"},
        "got quadrilaterals, wanted triangles; in gmsh: Mesh.RecombineAll = 0",
    ),
    "triangles of second order": (
        {"triangles": np.pad(MESH.triangles, ((0, 0), (0, 3)))},
        {"kind": "triangle6"},
        "triangles of second order, wanted first order; in gmsh: Mesh.ElementOrder = 1",
    ),
    "tetrahedra": (
        {"triangles": np.pad(MESH.triangles, ((0, 0), (0, 1)))},
        {"kind": "tetra"},
        "elements of the kind 'tetra', wanted triangles, in the plane z = 0",
    ),
    "no triangles": (
        {"triangles": MESH.triangles[:, :2]},
        {"kind": "line"},
        "no triangles, .*: put the surface into one",
    ),
}
"""How a mesh is changed, how it is written, and what is said of it."""


@pytest.mark.parametrize("row", REFUSED)
def test_a_mesh_is_refused(row, tmp_path):
    changes, how, message = REFUSED[row]
    path = written(tmp_path / "tiny.msh", replace(MESH, **changes), **how)
    with pytest.raises(ValueError, match=f"^mesh: tiny.msh: got .*{message.removeprefix('got ')}"):
        meshes.build(own(path))


def test_a_mesh_of_another_domain_or_other_parts_is_refused(tmp_path):
    path = written(tmp_path / "tiny.msh", MESH)
    with pytest.raises(ValueError, match=r"facet of 'right' at \(0.5, .* that is 0.1 off"):
        meshes.build(own(path, domain=Box(x=(-0.2, 0.6), y=(-0.2, 0.21))))
    wider = Circle("cylinder", (0, 0), 0.05, parts={"top": (80, 95), "bottom": (265, 275)})
    with pytest.raises(ValueError, match=r"facet of 'cylinder' at \(.*\) that is 0.00\d* off"):
        meshes.build(own(path, bodies=(wider,)))


def test_a_triangle_that_its_curve_would_fold_is_refused(tmp_path):
    thin, circles = MESH.points.copy(), len(MESH.points) // 5
    thin[circles : 2 * circles] = 1.04 * thin[:circles]  # the second of five rings, close to the cylinder
    path = written(tmp_path / "tiny.msh", replace(MESH, points=thin))
    with pytest.raises(
        ValueError, match=r"a triangle on 'cylinder' at \(.* bends by .* of its height, wanted at most 0.2"
    ):
        meshes.build(own(path))


def test_a_file_is_refused_that_is_missing_or_no_mesh_or_has_changed(tmp_path):
    path = tmp_path / "tiny.msh"
    with pytest.raises(ValueError, match=r"mesh: got '.*tiny.msh', which is no file, wanted .*with_name\('NAME.msh'\)"):
        Msh(path)
    path.write_text("solid cylinder\n")
    case = own(path)
    with pytest.raises(ValueError, match="mesh: tiny.msh: got what meshio cannot read .*Mesh.MshFileVersion = 4.1"):
        meshes.build(case)
    written(path, MESH)
    with pytest.raises(ValueError, match="got another file than when the case was made"):
        meshes.build(case)


@pytest.mark.parametrize("lacks", ["the package", "a library of the system"])
def test_who_has_no_gmsh_is_told_what_to_install_and_reads_meshes_all_the_same(lacks, tmp_path, monkeypatch):
    if lacks == "the package":
        monkeypatch.setitem(sys.modules, "gmsh", None)
    else:
        monkeypatch.delitem(sys.modules, "gmsh", raising=False)
        (tmp_path / "gmsh.py").write_text("raise OSError('libGLU.so.1: cannot open shared object file')")
        monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(RuntimeError, match=r"gmsh cannot be loaded \(.*\); .*'manywake\[gmsh\]' \(it needs libGLU and"):
        meshes.build(replace(cylinder_jets.CASE, sizes=Sizes(far=2.0)))
    monkeypatch.delitem(sys.modules, "gmsh", raising=False)
    assert len(meshes.build(own(written(tmp_path / "tiny.msh", MESH))).triangles) == len(MESH.triangles)
    monkeypatch.setitem(sys.modules, "gmsh", None)


def test_gmsh_s_own_file_is_read_in_versions_two_and_four(tmp_path):
    gmsh = pytest.importorskip("gmsh", exc_type=(ImportError, OSError))
    (x0, x1), (y0, y1) = TINY.domain.x, TINY.domain.y
    areas = []
    gmsh.initialize(interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    rectangle, disk = (
        gmsh.model.occ.addRectangle(x0, y0, 0, x1 - x0, y1 - y0),
        gmsh.model.occ.addDisk(0, 0, 0, 0.05, 0.05),
    )
    ((_, fluid),), _ = gmsh.model.occ.cut([(2, rectangle)], [(2, disk)])
    gmsh.model.occ.synchronize()
    for _, curve in gmsh.model.getBoundary([(2, fluid)], oriented=False):
        x, y, _ = gmsh.model.occ.getCenterOfMass(1, curve)
        at = {"left": x - x0, "right": x - x1, "bottom": y - y0, "top": y - y1}
        name = next((side for side, off in at.items() if abs(off) < 1e-9), "cylinder")
        gmsh.model.addPhysicalGroup(1, [curve], name=name)
    gmsh.model.addPhysicalGroup(2, [fluid], name="fluid")
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.03)
    gmsh.model.mesh.generate(2)
    for version, binary in ((2.2, 0), (2.2, 1), (4.1, 0), (4.1, 1)):
        gmsh.option.setNumber("Mesh.MshFileVersion", version)
        gmsh.option.setNumber("Mesh.Binary", binary)
        gmsh.write(str(tmp_path / "own.msh"))
        case = own(tmp_path / "own.msh", bodies=(Circle("cylinder", (0, 0), 0.05),), actuators=())
        areas.append(spaces.build(meshes.build(case)).velocity.dx.sum())
    gmsh.finalize()
    np.testing.assert_allclose(areas, (x1 - x0) * (y1 - y0) - np.pi * 0.05**2, rtol=1e-5)
