"""Fields at the vertices of a mesh, as columns of a table, and how they are drawn."""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.tri import Triangulation

from experiments.experiment import Table
from manywake.case.case import Case
from manywake.flow.mesh import Mesh


def rows(mesh: Mesh, **fields: np.ndarray) -> list[dict[str, float]]:
    """Return a row per vertex: x, y and each field, (vertices,)."""
    columns = {"x": mesh.points[:, 0], "y": mesh.points[:, 1], **fields}
    return [
        dict(zip(columns, (round(float(value), 5) for value in values), strict=True))
        for values in zip(*columns.values(), strict=True)
    ]


def draw(axis, case: Case, table: Table, field: str, **style):
    """Draw a field between the vertices; the triangles are made anew from them."""
    (cylinder,), box = case.bodies, case.domain
    mesh = Triangulation(table["x"], table["y"])
    x, y = (table[name][mesh.triangles].mean(axis=1) for name in ("x", "y"))
    mesh.set_mask(np.hypot(x, y) < cylinder.radius)
    picture = axis.tripcolor(mesh, table[field], shading="gouraud", rasterized=True, **style)
    axis.add_patch(plt.Circle(cylinder.centre, cylinder.radius, color="#dddddd", lw=0))
    axis.set_aspect("equal")
    axis.set_xlim(*box.x)
    axis.set_xticks(np.arange(0.0, box.x[1], 0.25))
    axis.set_ylim(*box.y)
    axis.set_ylabel("y [10 D]")
    return picture
