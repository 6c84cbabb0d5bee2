"""Meshes of the user's: gmsh's .msh files, read by meshio, and refused where they are not meshes of the case.

The groups of lines (physical groups of dimension 1) have the names of the sides of the domain and of the pieces of the
bodies. What is wrong is told with its place, what was wanted, and what gmsh does about it.
"""

import hashlib
from pathlib import Path

import numpy as np

from manywake.case.case import Case
from manywake.case.geometry import Msh, distance

OFF = 1e-4
"""How far the ends of a facet may be from the curve or the side that it is a part of, in L."""
BEND = 0.2
"""How far the curve may reach into a triangle, by the triangle's height; at 1/4 the curved triangle has a cusp."""
_REMEDY = {
    "quad": "got quadrilaterals, wanted triangles; in gmsh: Mesh.RecombineAll = 0",
    "triangle6": "got triangles of second order, wanted first order; in gmsh: Mesh.ElementOrder = 1",
}


def read(case: Case, given: Msh) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Return points (n, 2), triangles (e, 3), and facets (f, 2) by name, of the file that is given as a case's mesh.

    ValueError when it holds no mesh of this case.
    """
    try:
        points, triangles, groups = _parsed(given, OFF * case.scales.length)
        _check_names(case, groups)
        boundaries = {name: np.concatenate(groups[name]) for name in names(case)}
        _check_triangles(points, triangles)
        _check_boundary(points, triangles, boundaries)
        for name, facets in boundaries.items():
            _check_place(case, name, points, facets)
        _check_bent(case, points, triangles, boundaries)
    except ValueError as error:
        raise ValueError(f"mesh: {Path(given.path).name}: {error}") from error
    _straighten(case, points, boundaries)
    return points, triangles, boundaries


def names(case: Case) -> list[str]:
    """Return the names of all sides of the domain and of all pieces of the bodies."""
    pieces = [piece.name for body in case.bodies for piece in body.pieces()]
    return list(dict.fromkeys([*(side.name for side in case.domain.sides()), *pieces]))


def _parsed(given: Msh, off: float) -> tuple[np.ndarray, np.ndarray, dict[str, list[np.ndarray]]]:
    """Return points (n, 2), triangles (e, 3), and facets (f, 2) by groups of lines, as the file has them."""
    import meshio

    path = Path(given.path)
    if not path.is_file() or hashlib.sha256(path.read_bytes()).hexdigest() != given.sha256:
        raise ValueError("got another file than when the case was made, wanted the same; start again")
    try:
        found = meshio.gmsh.read(path)  # not meshio.read, which exits where it fails
    except Exception as error:  # of whatever kind, on a file that is none
        raise ValueError(
            f"got what meshio cannot read ({type(error).__name__}: {error}), wanted a mesh as gmsh saves it; in gmsh: "
            "Mesh.MshFileVersion = 4.1, Mesh.SaveAll = 0"
        ) from error
    kinds = {block.type for block in found.cells if len(block.data)}
    for kind in sorted(kinds - {"vertex", "line", "line3", "triangle"}):
        raise ValueError(_REMEDY.get(kind, f"got elements of the kind {kind!r}, wanted triangles, in the plane z = 0"))
    if "triangle" not in kinds:
        raise ValueError(
            "got no triangles, wanted those of the fluid; gmsh saves physical groups alone: put the surface into one"
        )
    if np.ptp(found.points[:, 2]) > off:
        raise ValueError("got points of different z, wanted all in the plane z = 0")
    groups: dict[str, list[np.ndarray]] = {name: [] for name, (_, dim) in found.field_data.items() if dim == 1}
    for k, block in enumerate(found.cells):
        for name in groups if block.type == "line" else ():
            if name in found.cell_sets:
                chosen = found.cell_sets[name][k]
            else:
                chosen = found.cell_data["gmsh:physical"][k] == found.field_data[name][0]  # before version 4.1
            groups[name].append(block.data[chosen].astype(int))
    triangles = np.concatenate([block.data for block in found.cells if block.type == "triangle"]).astype(int)
    return found.points[:, :2].copy(), triangles, groups


def _check_names(case: Case, groups: dict[str, list[np.ndarray]]) -> None:
    wanted, filled = names(case), [name for name, lines in groups.items() if sum(map(len, lines))]
    got = f"got groups of lines named {', '.join(filled) or 'nothing'}"
    if missing := [name for name in wanted if name not in filled]:
        raise ValueError(
            f"{got}, wanted {', '.join(missing)} too; in gmsh: addPhysicalGroup(1, curves, name={missing[0]!r}), or "
            f'Physical Curve("{missing[0]}") = {{...}};'
        )
    if more := [name for name in filled if name not in wanted]:
        raise ValueError(f"{got}, of which the case has no {', '.join(more)}; wanted {', '.join(wanted)} alone")


def _check_triangles(points: np.ndarray, triangles: np.ndarray) -> None:
    (ax, ay), (bx, by), (cx, cy) = (points[corner].T for corner in triangles.T)
    twice = abs((bx - ax) * (cy - ay) - (by - ay) * (cx - ax))
    longest = np.maximum.reduce([np.hypot(bx - ax, by - ay), np.hypot(cx - bx, cy - by), np.hypot(ax - cx, ay - cy)])
    flat = np.flatnonzero(~(twice > 1e-6 * longest**2))
    if len(flat):
        raise ValueError(f"got a triangle without area at {_at(points[triangles[flat[0]]])}, wanted none; mesh it anew")


def _check_boundary(points: np.ndarray, triangles: np.ndarray, boundaries: dict[str, np.ndarray]) -> None:
    """Refuse facets of a group within the fluid, and facets of the boundary that are in no group or in several."""
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, count = np.unique(edges, axis=0, return_counts=True)
    if (count > 2).any():
        raise ValueError(f"got more than two triangles on the edge at {_at(points[edges[count > 2][0]])}, wanted two")
    groups: dict[tuple[int, int], list[str]] = {(a, b): [] for a, b in edges[count == 1].tolist()}
    for name, facets in boundaries.items():
        for a, b in np.unique(np.sort(facets, axis=1), axis=0).tolist():
            if (a, b) not in groups:
                raise ValueError(
                    f"got a line of the group {name!r} at {_at(points[[a, b]])}, which is no boundary of the "
                    "triangles, wanted boundaries alone; cut the bodies out of the surface"
                )
            groups[a, b].append(name)
    for facet, found in groups.items():
        if len(found) != 1:
            got = f"in the groups {', '.join(found)}" if found else "in no group"
            raise ValueError(
                f"got a facet of the boundary {got}, at {_at(points[list(facet)])}, wanted each in exactly one; "
                "give its curve to one physical group"
            )


def _check_place(case: Case, name: str, points: np.ndarray, facets: np.ndarray) -> None:
    """Refuse facets that are not on the curve of their name: ends and middle, which is the curve's where it bends."""
    body, ends = case.body(name), points[facets]
    middle = ends.mean(axis=1) if body is None else body.between(ends[:, 0], ends[:, 1])
    x = np.concatenate([ends[:, 0], ends[:, 1], middle])
    off = np.min([distance(line, x) for line in _lines(case, name)], axis=0)
    worst = int(off.argmax())
    if not off[worst] <= OFF * case.scales.length:
        raise ValueError(
            f"got a facet of {name!r} at {_at(ends[worst % len(ends)])} that is {off[worst]:.2g} off, wanted at most "
            f"{OFF * case.scales.length:g}; the case and the mesh have to say the same of where {name!r} is"
        )


def _check_bent(case: Case, points: np.ndarray, triangles: np.ndarray, boundaries: dict[str, np.ndarray]) -> None:
    """Refuse triangles that fold over where their facet is bent along its curve: their height is too small for it."""
    edges, across = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), triangles[:, [2, 0, 1]].ravel()
    opposite = {(min(a, b), max(a, b)): c for (a, b), c in zip(edges.tolist(), across.tolist(), strict=True)}
    for name, facets in boundaries.items():
        body = case.body(name)
        if body is None or body.straight:
            continue
        a, b = points[facets[:, 0]], points[facets[:, 1]]
        c = points[[opposite[min(ends), max(ends)] for ends in facets.tolist()]]
        normal = np.stack([a[:, 1] - b[:, 1], b[:, 0] - a[:, 0]], axis=1) / np.linalg.norm(b - a, axis=1)[:, None]
        height = ((c - a) * normal).sum(axis=1)
        bend = ((body.between(a, b) - a) * normal).sum(axis=1) / height
        worst = int(bend.argmax())
        if bend[worst] > BEND:
            raise ValueError(
                f"got a triangle on {name!r} at {_at(np.stack([a, b], axis=1)[worst])} that its curve bends by "
                f"{bend[worst]:.2g} of its height, wanted at most {BEND:g}; make the facets shorter there"
            )


def _lines(case: Case, name: str) -> list[np.ndarray]:
    """Return points (n, 2) along each of the sides or pieces of a name, there and back as far as they bend."""
    body = case.body(name)
    if body is None:
        return [np.array([side.start, side.end]) for side in case.domain.sides() if side.name == name]
    found = []
    for piece in body.pieces():
        if piece.name == name:
            line = body.point(np.linspace(piece.start, piece.end, 2 if body.straight else 1001))
            found.append(np.concatenate([line, line[-2:0:-1]]))
    return found


def _straighten(case: Case, points: np.ndarray, boundaries: dict[str, np.ndarray]) -> None:
    """Put vertices that are a little off onto the sides of the domain, and into its corners."""
    for side in case.domain.sides():
        start, along = np.array(side.start), np.subtract(side.end, side.start)
        on = np.unique(boundaries[side.name])
        share = ((points[on] - start) @ along / (along @ along)).clip(0.0, 1.0)
        corner = abs(share - np.round(share)) * np.linalg.norm(along) < OFF * case.scales.length
        share[corner] = np.round(share[corner])
        onto = start + share[:, None] * along
        off = np.linalg.norm(points[on] - onto, axis=1)
        moved = (off > 1e-12 * case.scales.length) & (off < 2 * OFF * case.scales.length)
        points[on[moved]] = onto[moved]


def _at(points: np.ndarray) -> str:
    """Return the middle of some points as a text."""
    x, y = points.mean(axis=0)
    return f"({x:.4g}, {y:.4g})"
