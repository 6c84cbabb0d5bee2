"""Triangle meshes of any case, built by gmsh or read from a file of the user's. Baselines (.npz) keep them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from manywake.case.case import Case
from manywake.case.geometry import Body, Circle, Piece, distance, outline
from manywake.flow import msh
from manywake.machine import disk


@dataclass(frozen=True)
class Mesh:
    """Triangles with named boundaries, straight but for the facets of curved bodies.

    points: (n, 2) vertices. triangles: (e, 3) vertex numbers, counter-clockwise. boundaries: name of a side or a piece
    -> (f, 2) vertex numbers of its facets. curves: name of a boundary -> the body whose curve its facets follow.
    """

    points: np.ndarray
    triangles: np.ndarray
    boundaries: dict[str, np.ndarray]
    curves: Mapping[str, Body] = field(default_factory=dict)

    def middles(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the facets that are curved, (f, 2) vertex numbers, and the points of their curves amid each (f, 2)."""
        parts = [(self.boundaries[name], body) for name, body in self.curves.items() if not body.straight]
        if not parts:
            return np.empty((0, 2), int), np.empty((0, 2))
        x = [body.between(self.points[facets[:, 0]], self.points[facets[:, 1]]) for facets, body in parts]
        return np.concatenate([facets for facets, _ in parts]), np.concatenate(x)

    def digest(self) -> str:
        return disk.digest({"points": self.points, "triangles": self.triangles, **self.boundaries})


def curves(case: Case, names: list[str]) -> dict[str, Body]:
    """Return the body that each of the named boundaries is of, without the sides of the domain."""
    return {name: body for name in names if (body := case.body(name)) is not None}


def build(case: Case) -> Mesh:
    """Return a case's mesh: read from its file, or made by gmsh (the extra `manywake[gmsh]`).

    ValueError when the file's mesh is not one of this case, RuntimeError when gmsh cannot be loaded.
    """
    if case.mesh is not None:
        points, triangles, boundaries = msh.read(case, case.mesh)
        return _compact(points, triangles, boundaries, curves(case, list(boundaries)))
    try:
        import gmsh
    except (ImportError, OSError) as error:
        raise RuntimeError(
            f"mesh: no mesh of this geometry is shipped and gmsh cannot be loaded ({error}); "
            "install it with: pip install 'manywake[gmsh]' (it needs libGLU and libXrender from the system)"
        ) from error
    gmsh.initialize(interruptible=False)
    try:
        for option, value in (_REPEATABLE | _SIZED_BY_FIELD | _QUALITY).items():
            gmsh.option.setNumber(option, value)
        return _build(gmsh, case)
    finally:
        gmsh.finalize()


_REPEATABLE = {"General.Terminal": 0, "General.NumThreads": 1, "Mesh.RandomSeed": 1}
_SIZED_BY_FIELD = {"Mesh.MeshSizeExtendFromBoundary": 0, "Mesh.MeshSizeFromPoints": 0}
_QUALITY = {"Mesh.Algorithm": 6, "Mesh.Optimize": 1, "Mesh.Smoothing": 10}


def _build(gmsh, case: Case) -> Mesh:
    geo, sides, holes = gmsh.model.geo, case.domain.sides(), []
    corners = [geo.addPoint(*side.start, 0) for side in sides]
    lines = [geo.addLine(corners[k], corners[(k + 1) % len(sides)]) for k in range(len(sides))]
    named = [(side.name, line) for side, line in zip(sides, lines, strict=True)]
    for body in case.bodies:
        around, loop = _layers(geo, case, body)
        holes.append(loop)
        named += around
    geo.addPlaneSurface([geo.addCurveLoop(lines), *holes])
    geo.synchronize()
    size = SizeField(case)
    gmsh.model.mesh.setSizeCallback(lambda dim, tag, x, y, z, default: size(x, y))
    gmsh.model.mesh.generate(2)

    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    number = np.empty(int(max(tags)) + 1, int)
    number[tags] = np.arange(len(tags))
    xy = np.asarray(coordinates).reshape(-1, 3)[:, :2]
    triangles = number[gmsh.model.mesh.getElementsByType(2)[1]].reshape(-1, 3)
    boundaries: dict[str, np.ndarray] = {}
    for name, curve in named:
        facets = number[gmsh.model.mesh.getElementsByType(1, curve)[1]].reshape(-1, 2)
        boundaries[name] = np.concatenate([boundaries[name], facets]) if name in boundaries else facets
    return _compact(xy, triangles, boundaries, curves(case, list(boundaries)))


def _layers(geo, case: Case, body: Body) -> tuple[list[tuple[str, int]], int]:
    """Lay quadrilaterals around a body, patch by patch; return its curves by name, and the loop around them."""
    size, rays, centre = case.sizes, _rays(case, body), geo.addPoint(*body.centre, 0)
    heights = size.layer_height * case.scales.length * size.layer_growth ** np.arange(size.layers)

    def ring(height: float) -> tuple[list[int], list[int]]:
        points = [geo.addPoint(*body.point(np.array([piece.start]), height)[0], 0) for piece, _, _ in rays]
        around = zip(rays, points, [*points[1:], points[0]], strict=True)
        return points, [_curve(geo, body, *ray[:2], height, (a, b), centre) for ray, a, b in around]

    (inner_points, inner), (outer_points, outer) = ring(0.0), ring(float(heights.sum()))
    spokes = [geo.addLine(a, b) for a, b in zip(inner_points, outer_points, strict=True)]
    for k, (_, facets, growth) in enumerate(rays):
        after = (k + 1) % len(rays)
        patch = geo.addPlaneSurface([geo.addCurveLoop([inner[k], spokes[after], -outer[k], -spokes[k]])])
        geo.mesh.setTransfiniteCurve(inner[k], facets + 1, "Progression", growth)
        geo.mesh.setTransfiniteCurve(outer[k], facets + 1, "Progression", growth)
        geo.mesh.setTransfiniteCurve(spokes[k], size.layers + 1, "Progression", size.layer_growth)
        geo.mesh.setTransfiniteSurface(patch, "AlternateLeft")
    return [(piece.name, curve) for (piece, _, _), curve in zip(rays, inner, strict=True)], geo.addCurveLoop(outer)


def _rays(case: Case, body: Body) -> list[tuple[Piece, int, float]]:
    """Return the pieces of a body with their facets, and how much longer each facet is than the one before.

    Parts have facets of one length. Between them facets grow from the length of a part's to `Sizes.body` half way, in
    patches of at most a quarter of the turn.
    """
    rays, pieces, L = [], body.pieces(), case.scales.length
    largest = case.sizes.body * L
    lengths = [_length(body, piece.start, piece.end) for piece in pieces]

    def facet(k: int) -> float:
        part = pieces[k % len(pieces)].name != body.name
        return min(lengths[k % len(pieces)] / case.sizes.part_facets, largest) if part else largest

    for k, piece in enumerate(pieces):
        if piece.name != body.name:
            rays.append((piece, case.sizes.part_facets, 1.0))
            continue
        first, last = facet(k - 1), facet(k + 1)
        graded, turn = min(first, last) < largest, 0.0 if body.straight else piece.end - piece.start
        count = 2 * math.ceil(max(turn, 1.0) / 180) if graded else max(math.ceil(turn / 90), 1)
        ends = np.linspace(piece.start, piece.end, count + 1)
        along = np.interp(np.linspace(0, 1, count + 1), (0.0, 0.5, 1.0), (first, largest, last))
        for j in range(count):
            part = _length(body, ends[j], ends[j + 1])
            a, b = float(along[j]), float(along[j + 1])
            facets = max(round(part / a if a == b else part * math.log(b / a) / (b - a)), 1)
            mine = Piece(piece.name, float(ends[j]), float(ends[j + 1]))
            rays.append((mine, facets, (b / a) ** (1 / max(facets - 1, 1))))
    return rays


def _length(body: Body, start: float, end: float) -> float:
    along = body.point(np.linspace(start, end, 2 if body.straight else 200))
    return float(np.linalg.norm(np.diff(along, axis=0), axis=1).sum())


def _curve(geo, body: Body, piece: Piece, facets: int, height: float, ends: tuple[int, int], centre: int) -> int:
    """Return gmsh's curve along a piece: a line, an arc, or a spline through the points at which facets will end."""
    if body.straight:
        return geo.addLine(*ends)
    if isinstance(body, Circle):
        return geo.addCircleArc(ends[0], centre, ends[1])
    inner = np.linspace(piece.start, piece.end, 4 * facets + 1)[1:-1]
    return geo.addSpline([ends[0], *(geo.addPoint(*xy, 0) for xy in body.point(inner, height)), ends[1]])


class SizeField:
    """The wanted size of a triangle at a point outside the layers."""

    def __init__(self, case: Case):
        size, L = case.sizes, case.scales.length
        self.sizes, self.length, self.bodies = size, L, []
        self.near = [
            (near, np.array([side.start, side.end]))
            for near in size.near
            for side in case.domain.sides()
            if side.name in near.on
        ]
        height = L * size.layer_height * float((size.layer_growth ** np.arange(size.layers)).sum())
        for body in case.bodies:
            bare, ring = outline(body), outline(body, height, 180)
            facets = size.body * L * (_perimeter(ring) / _perimeter(bare))
            self.bodies.append((body.centre[0], bare[:, 0].max(), ring, facets))
        every = np.concatenate([outline(body) for body in case.bodies]) if case.bodies else np.zeros((1, 2))
        (self.front, low), (self.back, high) = every.min(axis=0), every.max(axis=0)
        self.axis, self.half = 0.5 * (low + high) if size.wake_axis is None else size.wake_axis, 0.5 * (high - low)

    def __call__(self, x: float, y: float) -> float:
        size, L, least = self.sizes, self.length, self.sizes.far * self.length
        for near, side in self.near:
            least = min(least, near.size * L + near.growth * distance(side, np.array([[x, y]]))[0])
        if not self.bodies:
            return least
        for centre, back, ring, facets in self.bodies:
            # faster where the flow comes from; slower downstream, where the shear layers roll up
            growth = 0.14 - 0.04 * min(max((x - centre) / (back - centre), 0.0), 1.0)
            least = min(least, facets + growth * distance(ring, np.array([[x, y]]))[0])
        wake = size.wake * L + 0.045 * max(x - self.back - 2.5 * L, 0.0)
        wake += 0.4 * max(abs(y - self.axis) - self.half - 0.5 * L, 0.0) + 0.6 * max(self.front - x, 0.0)
        return min(least, wake)


def _perimeter(polygon: np.ndarray) -> float:
    return float(np.linalg.norm(np.roll(polygon, -1, axis=0) - polygon, axis=1).sum())


def _compact(points: np.ndarray, triangles: np.ndarray, boundaries: dict, bodies: Mapping[str, Body]) -> Mesh:
    """Drop unused points (circle centres), turn all triangles counter-clockwise, and put vertices on the curves."""
    used, triangles = np.unique(triangles, return_inverse=True)
    points, triangles = points[used], triangles.reshape(-1, 3)
    (ax, ay), (bx, by), (cx, cy) = (points[corner].T for corner in triangles.T)
    clockwise = (bx - ax) * (cy - ay) < (by - ay) * (cx - ax)
    triangles[clockwise] = triangles[clockwise][:, [0, 2, 1]]
    named = {name: np.searchsorted(used, facets) for name, facets in boundaries.items()}
    for name, body in bodies.items():  # splines are a little off the curves
        on = np.unique(named[name])
        points[on] = body.between(points[on], points[on])
    return Mesh(points, triangles.astype(np.int64), named, bodies)


def refine(mesh: Mesh) -> Mesh:
    """Cut every triangle into four; the new vertices of curved facets go onto their curves."""
    edges = np.sort(mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, inverse = np.unique(edges, axis=0, return_inverse=True)
    n = len(mesh.points)
    points = np.concatenate([mesh.points, mesh.points[edges].mean(axis=1)])

    def middle(facets: np.ndarray) -> np.ndarray:
        return n + np.searchsorted(edges @ [n, 1], np.sort(facets, axis=1) @ [n, 1])  # edges are sorted by vertices

    halves = {name: (facets[:, 0], middle(facets), facets[:, 1]) for name, facets in mesh.boundaries.items()}
    boundaries = {name: np.concatenate([np.c_[a, m], np.c_[m, b]]) for name, (a, m, b) in halves.items()}
    curved, x = mesh.middles()
    points[middle(curved)] = x
    (a, b, c), (ab, bc, ca) = mesh.triangles.T, (n + inverse.reshape(-1, 3)).T
    triangles = np.concatenate([np.c_[a, ab, ca], np.c_[ab, b, bc], np.c_[ca, bc, c], np.c_[ab, bc, ca]])
    return Mesh(points, triangles, boundaries, mesh.curves)
