"""Write ground.msh: a cylinder above the ground, with gmsh's OpenCASCADE kernel. Run it once: python make_mesh.py."""

import math
from pathlib import Path

import gmsh

X, Y, RADIUS = (-8.0, 20.0), (-1.5, 8.0), 0.5
JETS = {"cylinder.top": (80, 100), "cylinder.bottom": (260, 280)}
"""Degrees from the downstream direction, as the case has them."""


def write(path: Path, finest: float = 0.045, wake: float = 0.16, coarsest: float = 1.0) -> None:
    """Write the mesh; its groups of lines have the names of the case's sides and pieces.

    finest, wake, coarsest: sides of the triangles at the cylinder, behind it, and far from it.
    """
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        groups = _geometry(gmsh.model.occ)
        gmsh.model.occ.synchronize()
        for name, curves in groups.items():
            gmsh.model.addPhysicalGroup(1, curves, name=name)
        gmsh.model.addPhysicalGroup(2, [1], name="fluid")  # gmsh saves what is in a group
        cylinder = [curve for name, curves in groups.items() if name.startswith("cylinder") for curve in curves]
        _sizes(gmsh.model.mesh.field, cylinder, finest, wake, coarsest)
        gmsh.model.mesh.generate(2)
        gmsh.write(str(path))
    finally:
        gmsh.finalize()


def _geometry(occ) -> dict[str, list[int]]:
    """Add the fluid as surface 1; return its curves by the names of their groups."""
    corners = [occ.addPoint(x, y, 0) for x, y in ((X[0], Y[0]), (X[1], Y[0]), (X[1], Y[1]), (X[0], Y[1]))]
    sides = [occ.addLine(corners[k], corners[(k + 1) % 4]) for k in range(4)]
    groups = {name: [side] for name, side in zip(("bottom", "right", "top", "left"), sides, strict=True)}
    ends = sorted(angle for jet in JETS.values() for angle in jet)
    places = [(RADIUS * math.cos(math.radians(angle)), RADIUS * math.sin(math.radians(angle))) for angle in ends]
    centre, points = occ.addPoint(0, 0, 0), [occ.addPoint(x, y, 0) for x, y in places]
    arcs = []
    for k, start in enumerate(ends):
        after = (k + 1) % len(ends)
        arcs.append(occ.addCircleArc(points[k], centre, points[after]))
        name = next((jet for jet, angles in JETS.items() if angles == (start, ends[after])), "cylinder")
        groups.setdefault(name, []).append(arcs[-1])
    occ.addPlaneSurface([occ.addCurveLoop(sides), occ.addCurveLoop(arcs)], 1)
    return groups


def _sizes(field, cylinder: list[int], finest: float, wake: float, coarsest: float) -> None:
    """Let triangles grow with the distance from the cylinder, and keep them small in a box behind it."""
    distance, near, box, least = (field.add(kind) for kind in ("Distance", "MathEval", "Box", "Min"))
    field.setNumbers(distance, "CurvesList", cylinder)
    field.setNumber(distance, "Sampling", 200)
    field.setString(near, "F", f"{finest} + 0.12 * F{distance}")
    limits = {"XMin": 0, "XMax": 6, "YMin": Y[0], "YMax": 1.5, "Thickness": 8, "VIn": wake, "VOut": coarsest}
    for name, value in limits.items():
        field.setNumber(box, name, value)
    field.setNumbers(least, "FieldsList", [near, box])
    field.setAsBackgroundMesh(least)
    gmsh.option.setNumber("Mesh.MeshSizeExtendFromBoundary", 0)


if __name__ == "__main__":
    write(Path(__file__).with_name("ground.msh"))
