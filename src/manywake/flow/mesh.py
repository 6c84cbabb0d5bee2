"""Triangle meshes of the channel, built by gmsh. Baselines (.npz) keep them."""

import math
from dataclasses import dataclass

import numpy as np

from manywake.flow import disk
from manywake.flow.case import Case


@dataclass(frozen=True)
class Mesh:
    """Triangles with named boundaries, straight but for the facets of the cylinder, which are arcs about the origin.

    points: (n, 2) vertices. triangles: (e, 3) vertex numbers, counter-clockwise. boundaries: name -> (f, 2) vertex
    numbers of its facets; the names are wall, inlet, outlet, cylinder, and jet0, jet1, ... in the order of the case.
    """

    points: np.ndarray
    triangles: np.ndarray
    boundaries: dict[str, np.ndarray]

    def arcs(self) -> np.ndarray:
        """Return the facets of cylinder and jets, (f, 2) vertex numbers: the curved ones."""
        facets = [f for name, f in self.boundaries.items() if name == "cylinder" or name[:3] == "jet"]
        return np.concatenate(facets) if facets else np.empty((0, 2), int)

    def digest(self) -> str:
        """Return a hash of the mesh's content."""
        return disk.digest({"points": self.points, "triangles": self.triangles, **self.boundaries})


def build(case: Case) -> Mesh:
    """Mesh the case's channel with gmsh (the extra `manywake[gmsh]`)."""
    try:
        import gmsh
    except (ImportError, OSError) as error:
        raise RuntimeError(
            f"mesh: case {case.name!r} ships no mesh and gmsh cannot be loaded ({error}); "
            "install it with: pip install 'manywake[gmsh]' (it needs libGLU and libXrender from the system)"
        ) from error
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("General.NumThreads", 1)
        return _build(gmsh, case)
    finally:
        gmsh.finalize()


def _build(gmsh, case: Case) -> Mesh:
    geo, size, r = gmsh.model.geo, case.resolution, case.radius
    (x0, x1), (y0, y1) = case.x_range, case.y_range
    corners = [geo.addPoint(x, y, 0) for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))]
    sides = [geo.addLine(corners[i], corners[(i + 1) % 4]) for i in range(4)]
    groups = {"wall": [sides[0], sides[2]], "outlet": [sides[1]], "inlet": [sides[3]]}

    # rays from the cylinder cut the layers around it into patches: each jet, and what lies between in equal pieces
    edges = sorted(
        (jet.angle + sign * jet.width / 2, f"jet{i}" if sign < 0 else "cylinder")
        for i, jet in enumerate(case.jets)
        for sign in (-1, 1)
    ) or [(0.0, "cylinder")]
    rays: list[tuple[float, str, int]] = []
    for (start, name), (end, _) in zip(edges, [*edges[1:], (edges[0][0] + 360, "")], strict=True):
        pieces = 1 if name != "cylinder" else math.ceil((end - start) / 90)
        step = (end - start) / pieces
        facets = size.jet_facets if name != "cylinder" else round(math.radians(step) * r / size.cylinder)
        rays += [(start + k * step, name, max(facets, 1)) for k in range(pieces)]
    heights = size.layer_height * size.layer_growth ** np.arange(size.layers)
    outer = r + float(heights.sum())
    centre = geo.addPoint(0, 0, 0)

    def ring(radius: float) -> tuple[list[int], list[int]]:
        at = [math.radians(angle) for angle, _, _ in rays]
        points = [geo.addPoint(radius * math.cos(a), radius * math.sin(a), 0) for a in at]
        return points, [geo.addCircleArc(points[k - 1], centre, points[k]) for k in [*range(1, len(points)), 0]]

    (inner_points, inner_arcs), (outer_points, outer_arcs) = ring(r), ring(outer)
    spokes = [geo.addLine(a, b) for a, b in zip(inner_points, outer_points, strict=True)]
    patches = []
    for k, (_, name, facets) in enumerate(rays):
        after = (k + 1) % len(rays)
        loop = geo.addCurveLoop([inner_arcs[k], spokes[after], -outer_arcs[k], -spokes[k]])
        patches.append(geo.addPlaneSurface([loop]))
        for arc in (inner_arcs[k], outer_arcs[k]):
            geo.mesh.setTransfiniteCurve(arc, facets + 1)
        geo.mesh.setTransfiniteCurve(spokes[k], size.layers + 1, "Progression", size.layer_growth)
        geo.mesh.setTransfiniteSurface(patches[-1], "AlternateLeft")
        groups.setdefault(name, []).append(inner_arcs[k])
    geo.addPlaneSurface([geo.addCurveLoop(sides), geo.addCurveLoop(outer_arcs)])
    geo.synchronize()

    def triangle_size(dim, tag, x, y, z, default):
        return _size(case, outer, x, y)

    gmsh.option.setNumber("Mesh.MeshSizeExtendFromBoundary", 0)
    gmsh.option.setNumber("Mesh.MeshSizeFromPoints", 0)
    gmsh.option.setNumber("Mesh.Algorithm", 6)
    gmsh.option.setNumber("Mesh.RandomSeed", 1)
    gmsh.option.setNumber("Mesh.Optimize", 1)
    gmsh.option.setNumber("Mesh.Smoothing", 10)
    gmsh.model.mesh.setSizeCallback(triangle_size)
    gmsh.model.mesh.generate(2)

    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    number = {int(tag): k for k, tag in enumerate(tags)}
    xy = np.asarray(coordinates).reshape(-1, 3)[:, :2]
    _, elements = gmsh.model.mesh.getElementsByType(2)
    triangles = np.array([number[int(tag)] for tag in elements]).reshape(-1, 3)
    boundaries = {}
    for name, curves in groups.items():
        tagged = [gmsh.model.mesh.getElementsByType(1, curve)[1] for curve in curves]
        boundaries[name] = np.array([number[int(tag)] for tag in np.concatenate(tagged)]).reshape(-1, 2)
    return _compact(xy, triangles, boundaries)


def _size(case: Case, outer: float, x: float, y: float) -> float:
    """Return the wanted triangle size at a point outside the layers, which end at radius `outer`."""
    size = case.resolution
    # faster where the flow comes from; slower downstream, where the shear layers roll up
    growth = 0.14 - 0.04 * min(max(x / case.radius, 0.0), 1.0)
    near = size.cylinder * outer / case.radius + growth * max(math.hypot(x, y) - outer, 0.0)
    wake = size.wake + 0.045 * max(x - 0.3, 0.0) + 0.4 * max(abs(y - 0.005) - 0.1, 0.0) + 0.6 * max(-x - 0.05, 0.0)
    return min(near, wake, size.far)


def _compact(points: np.ndarray, triangles: np.ndarray, boundaries: dict[str, np.ndarray]) -> Mesh:
    """Drop unused points (circle centres), and turn all triangles counter-clockwise."""
    used, triangles = np.unique(triangles, return_inverse=True)
    triangles = triangles.reshape(-1, 3)
    renumber = {int(old): new for new, old in enumerate(used)}
    points = points[used]
    a, b, c = (points[triangles[:, k]] for k in range(3))
    clockwise = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) < (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    triangles[clockwise] = triangles[clockwise][:, [0, 2, 1]]
    named = {name: np.array([[renumber[int(v)] for v in f] for f in facets]) for name, facets in boundaries.items()}
    return Mesh(points, triangles.astype(np.int64), named)


def refine(mesh: Mesh, case: Case) -> Mesh:
    """Cut every triangle into four; the new vertices of the cylinder's facets go onto the circle."""
    edges = np.sort(mesh.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, inverse = np.unique(edges, axis=0, return_inverse=True)
    n = len(mesh.points)
    points = np.concatenate([mesh.points, mesh.points[edges].mean(axis=1)])
    number = {(int(a), int(b)): n + k for k, (a, b) in enumerate(edges)}
    boundaries = {}
    for name, facets in mesh.boundaries.items():
        mids = np.array([number[min(a, b), max(a, b)] for a, b in facets.tolist()])
        boundaries[name] = np.concatenate([np.c_[facets[:, 0], mids], np.c_[mids, facets[:, 1]]])
    middles = [number[min(a, b), max(a, b)] for a, b in mesh.arcs().tolist()]
    points[middles] *= (case.radius / np.linalg.norm(points[middles], axis=1))[:, None]
    a, b, c = mesh.triangles.T
    ab, bc, ca = (n + inverse.reshape(-1, 3)).T
    triangles = np.concatenate([np.c_[a, ab, ca], np.c_[ab, b, bc], np.c_[ca, bc, c], np.c_[ab, bc, ca]])
    return Mesh(points, triangles, boundaries)
