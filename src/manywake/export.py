"""A controlled flow as files for ParaView: VTU frames, the .pvd collection with their times, the bodies' outlines.

All numbers are in units of the case's scales: lengths in L, times in L / U, velocities in U, vorticity in U / L,
pressure in rho U^2. So what ParaView derives, a gradient or a path line, is in these units too.
"""

import xml.etree.ElementTree as etree
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import meshio
import numpy as np
import scipy.sparse as sp
import skfem
from scipy.sparse.linalg import splu

from manywake.case.case import Case, Scales
from manywake.case.geometry import outline
from manywake.case.task import Task
from manywake.env.control import ControlledFlows, drive
from manywake.flow.baseline import Progress
from manywake.flow.batch import Start
from manywake.flow.space import Space
from manywake.flow.store import Flow
from manywake.learn.controllers import Controller
from manywake.machine import disk

BODIES = "bodies.vtu"
"""File of the bodies' outlines, which do not move."""


@dataclass(frozen=True)
class Exported:
    """What was written: the collection, and the times of its frames in L / U. diverged: the flow blew up after them."""

    collection: Path
    times: tuple[float, ...]
    diverged: bool


def free(folder: Path) -> Path:
    """Return a folder that has no export yet; ValueError where it has one, whose frames would mix with the new."""
    if found := sorted([*folder.glob("*.pvd"), *folder.glob("*.vtu")]):
        raise ValueError(f"output: {found[0]} is there already; wanted a folder without an export: -o ANOTHER")
    return folder


def export(
    flow: Flow,
    task: Task,
    controller: Controller,
    folder: Path,
    actions: int | None = None,
    every: int = 1,
    name: str = "flow",
    progress: Progress | None = None,
) -> Exported:
    """Play an episode from the start state, and write a frame of its start and one after every so many actions.

    actions: how many, an episode's when not given. name: of the files. A flow that blows up has no more frames.
    ValueError where a number is below 1.
    """
    for word, number in {"actions": actions, "every": every}.items():
        if number is not None and number < 1:
            raise ValueError(f"{word}: got {number}, wanted at least 1")
    count, unit = actions or task.actions, flow.case.convective_time
    flows = ControlledFlows(flow, task, 1)
    flows.reset([0], [0], flow.baseline.start)
    folder.mkdir(parents=True, exist_ok=True)
    draw, digits = drawing(flow.operators.space, flow.case.scales), max(len(str(count)), 4)
    frames: dict[str, float] = {}

    def keep(after: int) -> None:
        path = folder / f"{name}-{after:0{digits}d}.vtu"
        draw(flows.batch.state(0)).write(path)
        frames[path.name] = after * task.interval / unit

    keep(0)
    diverged = False
    for t, step in enumerate(drive(flows, controller.on(flows), count), start=1):
        if diverged := bool(step.outcome.diverged[0]):
            break
        if t % every == 0:
            keep(t)
        if progress:
            progress(f"playing {name}", t / count)
    if flow.case.bodies:
        outlines(flow.case).write(folder / BODIES)
    collection = folder / f"{name}.pvd"
    _collect(frames, collection)
    return Exported(collection, tuple(frames.values()), diverged)


def drawing(space: Space, scales: Scales) -> Callable[[Start], meshio.Mesh]:
    """Return what turns a state on a mesh into a frame: quadratic triangles with velocity, pressure and vorticity."""
    points, cells, ends = _flat(space.x / scales.length), triangles(space), middles(space)
    curl, U = vorticity(space), scales.velocity

    def frame(state: Start) -> meshio.Mesh:
        p = np.concatenate([state.p, state.p[ends].mean(axis=1)])  # P1 is linear along every edge
        data = {"velocity": _flat(state.u / U), "pressure": p / U**2, "vorticity": curl(state.u) * scales.length / U}
        return meshio.Mesh(points, [("triangle6", cells)], {key: x.astype(np.float32) for key, x in data.items()})

    return frame


def triangles(space: Space) -> np.ndarray:
    """Return the nodes of all triangles in VTK's order, (elements, 6): vertices counter-clockwise, then the middles.

    The middles are those between the first and the second vertex, the second and the third, the third and the first.
    """
    nodes = space.nodes.astype(np.int32)  # scikit-fem has the same order, but sorts vertices by number
    a, b, c = (space.x[nodes[:, k]] for k in range(3))
    clockwise = (b - a)[:, 0] * (c - a)[:, 1] < (b - a)[:, 1] * (c - a)[:, 0]
    nodes[clockwise] = nodes[clockwise][:, [0, 2, 1, 5, 4, 3]]
    return nodes


def middles(space: Space) -> np.ndarray:
    """Return the two vertices that each mid-side node lies between, (n - m, 2), in the order of these nodes."""
    first = len(space.mesh.points)
    ends = np.empty((len(space.x) - first, 2), int)
    ends[space.nodes[:, 3:] - first] = np.stack([space.nodes[:, :3], space.nodes[:, [1, 2, 0]]], axis=2)
    return ends


def vorticity(space: Space) -> Callable[[np.ndarray], np.ndarray]:
    """Return what gives dv/dx - du/dy at the nodes (n,), projected onto P2, of a velocity u (n, 2)."""
    mass = splu(sp.csc_matrix(space.mass))
    form = skfem.LinearForm(lambda q, w: (w.v.grad[0] - w.u.grad[1]) * q)

    def curl(u: np.ndarray) -> np.ndarray:
        x, y = (space.velocity.interpolate(component) for component in u.T)
        return mass.solve(form.assemble(space.velocity, u=x, v=y))

    return curl


def outlines(case: Case) -> meshio.Mesh:
    """Return the bodies' outlines as closed lines, in L; the number of each body, from 0, goes with its lines."""
    rings = [outline(body) / case.scales.length for body in case.bodies]
    lines, number, first = [], [], 0
    for k, ring in enumerate(rings):
        along = np.arange(len(ring), dtype=np.int32)
        lines.append(first + np.stack([along, np.roll(along, -1)], axis=1))
        number.append(np.full(len(ring), k, np.int32))
        first += len(ring)
    cells, data = [("line", np.concatenate(lines))], {"body": [np.concatenate(number)]}
    return meshio.Mesh(_flat(np.concatenate(rings)), cells, cell_data=data)


def _flat(x: np.ndarray) -> np.ndarray:
    """Return vectors (k, 2) with a third component, 0: VTK knows only space."""
    return np.pad(x, ((0, 0), (0, 1)))


def _collect(frames: dict[str, float], path: Path) -> None:
    """Write the collection of frames, name of the file -> time."""
    root = etree.Element("VTKFile", type="Collection", version="0.1")
    collection = etree.SubElement(root, "Collection")
    for file, time in frames.items():
        etree.SubElement(collection, "DataSet", timestep=f"{time:.10g}", part="0", file=file)
    etree.indent(root)
    disk.write(path, lambda file: etree.ElementTree(root).write(file, encoding="utf-8", xml_declaration=True))
