"""What several test files need: the shipped case, assembled once, and a tiny channel around a cylinder."""

from functools import partial
from unittest import mock

import numpy as np
import pytest

from manywake.flow import baseline, case, operators
from manywake.flow.case import BDF2, Case
from manywake.flow.mesh import Mesh
from manywake.flow.operators import Operators


@pytest.fixture(scope="session")
def shipped():
    """Operators and baseline of the default case."""
    return baseline.assembled(case.by_name("cylinder-jets"))


@pytest.fixture(scope="session")
def ops(shipped):
    return shipped[0]


@pytest.fixture(scope="session")
def base(shipped):
    return shipped[1]


TINY = Case("tiny", scheme=BDF2, time_step=5e-4, x_range=(-0.2, 0.5), probes=((0.1, 0.0), (0.2, 0.05)))


def tiny_mesh(chosen: Case = TINY, layers: int = 4) -> Mesh:
    """Return a coarse mesh of rays from the cylinder to the channel's walls, two facets a jet; no gmsh needed."""
    (x0, x1), (y0, y1) = spans = chosen.x_range, chosen.y_range
    corners = np.degrees([np.arctan2(y, x) for x in (x0, x1) for y in (y0, y1)]) % 360
    angles = [85.0, 90.0, 95.0, 265.0, 270.0, 275.0, 0.0, 30.0, 60.0, 110.0, 150.0, 180.0, 210.0, 240.0, 300.0, 330.0]
    angles = np.sort(np.concatenate([angles, corners]))
    d = np.stack([np.cos(np.radians(angles)), np.sin(np.radians(angles))], axis=1)
    with np.errstate(divide="ignore"):
        reach = np.minimum(*(np.maximum(low / d[:, c], high / d[:, c]) for c, (low, high) in enumerate(spans)))
    share = np.linspace(0.0, 1.0, layers + 1) ** 1.5
    radius = chosen.radius + share[:, None] * (reach - chosen.radius)
    points = (radius[:, :, None] * d).reshape(-1, 2)
    count = len(angles)
    triangles, boundaries = [], {}
    for k in range(count):
        after = (k + 1) % count
        for layer in range(layers):
            a, b = layer * count + k, layer * count + after
            triangles += [(a, a + count, b), (b, a + count, b + count)]
        middle = 0.5 * (angles[k] + (angles[after] if after else angles[0] + 360))
        name = "jet0" if 85 < middle < 95 else "jet1" if 265 < middle < 275 else "cylinder"
        boundaries.setdefault(name, []).append((k, after))
        a, b = layers * count + k, layers * count + after
        x, y = 0.5 * (points[a] + points[b])
        side = "inlet" if abs(x - x0) < 1e-9 else "outlet" if abs(x - x1) < 1e-9 else "wall"
        assert side != "wall" or min(abs(y - y0), abs(y - y1)) < 1e-9
        boundaries.setdefault(side, []).append((a, b))
    return Mesh(points, np.array(triangles), {name: np.array(facets) for name, facets in boundaries.items()})


def in_doubles(chosen: Case, mesh: Mesh, mean: np.ndarray | None = None) -> Operators:
    """Return operators whose increments and residuals are doubles too, for comparison."""
    assemble = partial(operators.from_boundary_data, precision=np.float64)
    with mock.patch.object(operators, "from_boundary_data", assemble):
        return operators.assemble(chosen, mesh, mean)


@pytest.fixture(scope="session")
def tiny():
    """Operators of the tiny channel."""
    return operators.assemble(TINY, tiny_mesh())
