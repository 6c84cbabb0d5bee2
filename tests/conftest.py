"""What several test files need: the shipped case, assembled once, and a tiny channel around a cylinder."""

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from manywake.case import BDF2, Box, Case, Pressure, Velocity
from manywake.case.describe import flow_digest
from manywake.flow import baseline, problem, store
from manywake.flow import mesh as meshes
from manywake.flow.mesh import Mesh
from manywake.flow.operators import Operators
from manywake.machine import compile
from manywake.suite import cylinder_jets

signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell that starts us in the background has it ignored


@pytest.fixture
def one_thread():
    """Torch on one thread, on which networks this small are fastest."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="session")
def shipped():
    """The flow of the default case."""
    return store.flow(cylinder_jets.CASE)


@pytest.fixture(scope="session")
def ops(shipped):
    return shipped.operators


@pytest.fixture(scope="session")
def base(shipped):
    return shipped.baseline


POINTS = ((0.1, 0.0), (0.2, 0.05))
TINY = replace(
    cylinder_jets.CASE,
    scheme=BDF2,
    time_step=5e-4,
    domain=Box(x=(-0.2, 0.5), y=(-0.2, 0.21)),
    sensors=(Pressure("pressure", POINTS), Velocity("velocity", POINTS)),
)


def tiny_mesh(chosen: Case = TINY, layers: int = 4) -> Mesh:
    """Return a coarse mesh of rays from the cylinder to the channel's walls, two facets a jet; no gmsh needed."""
    (x0, x1), (y0, y1) = spans = chosen.domain.x, chosen.domain.y
    body = chosen.bodies[0].radius
    corners = np.degrees([np.arctan2(y, x) for x in (x0, x1) for y in (y0, y1)]) % 360
    angles = [85.0, 90.0, 95.0, 265.0, 270.0, 275.0, 0.0, 30.0, 60.0, 110.0, 150.0, 180.0, 210.0, 240.0, 300.0, 330.0]
    angles = np.sort(np.concatenate([angles, corners]))
    d = np.stack([np.cos(np.radians(angles)), np.sin(np.radians(angles))], axis=1)
    with np.errstate(divide="ignore"):
        reach = np.minimum(*(np.maximum(low / d[:, c], high / d[:, c]) for c, (low, high) in enumerate(spans)))
    share = np.linspace(0.0, 1.0, layers + 1) ** 1.5
    radius = body + share[:, None] * (reach - body)
    points = (radius[:, :, None] * d).reshape(-1, 2)
    count = len(angles)
    triangles, boundaries = [], {}
    for k in range(count):
        after = (k + 1) % count
        for layer in range(layers):
            a, b = layer * count + k, layer * count + after
            triangles += [(a, a + count, b), (b, a + count, b + count)]
        middle = 0.5 * (angles[k] + (angles[after] if after else angles[0] + 360))
        name = "cylinder.top" if 85 < middle < 95 else "cylinder.bottom" if 265 < middle < 275 else "cylinder"
        boundaries.setdefault(name, []).append((k, after))
        a, b = layers * count + k, layers * count + after
        x, y = 0.5 * (points[a] + points[b])
        at = {"left": x - x0, "right": x - x1, "bottom": y - y0, "top": y - y1}
        (side,) = [side for side, off in at.items() if abs(off) < 1e-9]
        boundaries.setdefault(side, []).append((a, b))
    boundaries = {name: np.array(facets) for name, facets in boundaries.items()}
    return Mesh(points, np.array(triangles), boundaries, meshes.curves(chosen, list(boundaries)))


def in_singles(chosen: Case, mesh: Mesh, *advecting: np.ndarray) -> Operators:
    """Return the operators of a case on a mesh. advecting: mean flow and fluctuation, if need be."""
    return baseline.assemble(chosen, problem.pose(chosen, mesh), *(advecting or (None,)))


def in_doubles(chosen: Case, mesh: Mesh, *advecting: np.ndarray) -> Operators:
    """Return operators whose increments and residuals are doubles too, for comparison."""
    return baseline.assemble(chosen, problem.pose(chosen, mesh), *(advecting or (None,)), precision=np.float64)


@pytest.fixture(scope="session")
def tiny():
    """Operators of the tiny channel."""
    return in_singles(TINY, tiny_mesh())


@contextmanager
def pretended(cache: Path, base: baseline.Baseline, *cases: Case) -> Iterator[None]:
    """Put a baseline of the same mesh where the baselines of other cases are looked for."""
    before = {name: os.environ.get(name) for name in ("XDG_CACHE_HOME", "NUMBA_CACHE_DIR")}
    os.environ["NUMBA_CACHE_DIR"] = before["NUMBA_CACHE_DIR"] or compile._cache_folder()
    os.environ["XDG_CACHE_HOME"] = str(cache)
    for case in cases:
        baseline.save(replace(base, flow_digest=flow_digest(case)), store.cache_path(case))
    yield
    for name, value in before.items():
        os.environ.pop(name) if value is None else os.environ.update({name: value})
