"""The mesh and the start state of the peers, peers.npz: the paper's sizes, about 9300 triangles.

Run: python benchmarks/peers/make_mesh.py (once; needs gmsh, two minutes). Sizes are those of the paper's released code:
0.0025 on the cylinder, 0.0125 at the inlet's corners, 0.025 from half a unit behind the cylinder on, in between what
gmsh makes of them; no layers. SCALE makes up for gmsh 4 giving fewer triangles than
the gmsh 3 of 2019. The start state is a developed Karman street, stepped by manywake with the paper's scheme.
"""

import math
import sys
from pathlib import Path

import gmsh
import numpy as np
import shared

from manywake.case import Case
from manywake.flow import baseline, problem, readings, spinup, statistics, store
from manywake.flow.batch import FlowBatch, Start
from manywake.flow.mesh import Mesh
from manywake.suite import cylinder_jets, cylinder_jets_goda

OUT = Path(__file__).with_name("peers.npz")
SCALE = 0.96
JET_FACETS = 4
NAMES = {
    "wall": ("bottom", "top"),
    "outlet": ("right",),
    "inlet": ("left",),
    "jet0": ("cylinder.top",),
    "cylinder": ("cylinder",),
    "jet1": ("cylinder.bottom",),
}
"""What the peers call the boundaries."""
TIME = 8.0
"""From the interpolated start state of `make train` to the street of this mesh and scheme."""


def mesh(case: Case, scale: float = SCALE) -> Mesh:
    """Mesh the channel in two pieces that meet half a unit behind the cylinder; all facets are straight."""
    gmsh.initialize(interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("General.NumThreads", 1)
    gmsh.option.setNumber("Mesh.MeshSizeFactor", scale)
    (cylinder,) = case.bodies
    geo, r = gmsh.model.geo, cylinder.radius
    (x0, x1), (y0, y1) = case.domain.x, case.domain.y
    cut = r + 0.5
    at = [(x0, y0), (cut, y0), (x1, y0), (x1, y1), (cut, y1), (x0, y1)]
    corner = [geo.addPoint(x, y, 0, 0.0125 if x == x0 else 0.025) for x, y in at]
    side = [geo.addLine(corner[k], corner[(k + 1) % 6]) for k in range(6)]
    across = geo.addLine(corner[1], corner[4])
    groups = {"bottom": [side[0], side[1]], "top": [side[3], side[4]], "right": [side[2]], "left": [side[5]]}

    # arcs: each jet, and two between jets on either side
    centre = geo.addPoint(0, 0, 0)
    jets = [(begin, end, f"cylinder.{part}") for part, (begin, end) in cylinder.parts.items()]
    starts: list[tuple[float, str]] = []
    for (begin, end, name), (after, _, _) in zip(jets, [*jets[1:], (jets[0][0] + 360, 0, "")], strict=True):
        starts += [(begin, name), (end, "cylinder"), ((end + after) / 2, "cylinder")]
    ring = [geo.addPoint(r * math.cos(a), r * math.sin(a), 0, 0.0025) for a in (math.radians(a) for a, _ in starts)]
    arcs = [geo.addCircleArc(ring[k], centre, ring[(k + 1) % len(ring)]) for k in range(len(ring))]
    for (_, name), arc in zip(starts, arcs, strict=True):
        groups.setdefault(name, []).append(arc)
        if name != "cylinder":
            geo.mesh.setTransfiniteCurve(arc, JET_FACETS + 1)
    geo.addPlaneSurface([geo.addCurveLoop([side[0], across, side[4], side[5]]), geo.addCurveLoop(arcs)])
    geo.addPlaneSurface([geo.addCurveLoop([side[1], side[2], side[3], -across])])
    geo.synchronize()
    gmsh.option.setNumber("Mesh.RandomSeed", 1)
    gmsh.model.mesh.generate(2)

    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    number = np.zeros(int(max(tags)) + 1, np.int64)
    triangles = gmsh.model.mesh.getElementsByType(2)[1].astype(np.int64)
    used = np.unique(triangles)  # not the centre of the circle
    number[used] = np.arange(len(used))
    xy = np.zeros((len(number), 2))
    xy[tags.astype(np.int64)] = coordinates.reshape(-1, 3)[:, :2]
    facets = {
        name: number[np.concatenate([gmsh.model.mesh.getElementsByType(1, c)[1] for c in curves]).astype(np.int64)]
        for name, curves in groups.items()
    }
    gmsh.finalize()
    points, triangles = xy[used], number[triangles].reshape(-1, 3)
    a, b, c = (points[triangles[:, k]] for k in range(3))
    clockwise = np.linalg.det(np.stack([b - a, c - a], axis=1)) < 0
    triangles[clockwise] = triangles[clockwise][:, [0, 2, 1]]
    return Mesh(points, triangles, {name: f.reshape(-1, 2) for name, f in facets.items()})


def start(case: Case, of: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Return velocity u (n, 2) in the order of shared.nodes and pressure p (m,) of the developed street."""
    coarse = store.flow(cylinder_jets.CASE)
    space, base = coarse.operators.space, coarse.baseline
    ops = baseline.assemble(case, problem.pose(case, of), None)

    def inside(x: np.ndarray) -> np.ndarray:
        distance = np.linalg.norm(x, axis=1)
        return (x * (np.maximum(distance, 1.01 * case.bodies[0].radius) / distance)[:, None]).T

    u = space.velocity.probes(inside(ops.space.x)) @ base.start.u
    p = space.pressure.probes(inside(of.points)) @ base.start.p
    u[ops.velocity_order[ops.free :]] = ops.tables.fixed
    flow = FlowBatch(ops, Start(u, u, p, 0 * p, 0 * p), 1)
    steps = round(TIME / case.dt)
    record = readings.joined([spinup.free_run(flow, 1000) for _ in range(steps // 1000)])
    late = {name: series[-steps // 2 :] for name, series in record.items()}
    print(statistics.uncontrolled(late, spinup.clock(case), case.dt, "periodic"), file=sys.stderr)
    state = flow.state(0)
    place = shared.match(ops.space.x, shared.nodes(of.points, of.triangles))
    return state.u[place], state.p


def main() -> None:
    case = cylinder_jets_goda.CASE
    made = mesh(case)
    centre = made.points[made.triangles].mean(axis=1)
    print(
        f"{len(made.triangles)} triangles, {len(made.points)} vertices, "
        f"{(np.hypot(*centre.T) < 0.1).sum()} within 0.1 of the centre, {(centre[:, 0] > 0.55).sum()} behind 0.55,",
        {name: len(facets) for name, facets in made.boundaries.items()},
        file=sys.stderr,
    )
    u, p = start(case, made)
    np.savez_compressed(
        OUT,
        points=made.points,
        triangles=made.triangles.astype(np.int32),
        **{
            f"boundary_{name}": np.concatenate([made.boundaries[own] for own in ours]).astype(np.int32)
            for name, ours in NAMES.items()
        },
        probes=np.array(cylinder_jets.PROBES),
        start_u=u.astype(np.float32),
        start_p=p.astype(np.float32),
    )


if __name__ == "__main__":
    main()
