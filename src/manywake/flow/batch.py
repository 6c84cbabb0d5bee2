"""A batch of flows: B columns that start from given states, advance together and are read together."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from manywake.flow import kernels, readings, stepper
from manywake.flow.disturb import Disturbances
from manywake.flow.operators import Operators
from manywake.flow.stepper import State
from manywake.machine import simd

_CHUNK = 1000


@dataclass(frozen=True)
class Start:
    """One flow's state in scikit-fem's order, whatever the batch. u, u_old: (n, 2). p, phi, phi_old: (m,)."""

    u: np.ndarray
    u_old: np.ndarray
    p: np.ndarray
    phi: np.ndarray
    phi_old: np.ndarray


def widths(flows: int) -> list[int]:
    """Return the lane counts of the blocks that carry `flows` flows; the last block may be padded."""
    blocks = [simd.WIDTHS[0]] * (flows // simd.WIDTHS[0])
    rest = flows - sum(blocks)
    return blocks + ([min(width for width in simd.WIDTHS if width >= rest)] if rest else [])


class FlowBatch:
    """B independent flows of one case. A flow's numbers do not depend on B, on its column, or on its neighbours.

    Their disturbances are drawn from a seed each, that of a column being its number until `reset` gives another.
    """

    def __init__(self, ops: Operators, start: Start, flows: int):
        if flows < 1:
            raise ValueError(f"flows: got {flows}, wanted at least 1")
        self.ops, self.flows, self._start = ops, flows, start
        self._blocks = [_empty(ops, width) for width in widths(flows)]
        self._columns = [(b, lane) for b, width in enumerate(widths(flows)) for lane in range(width)]
        self._disturbances = Disturbances(ops, range(flows))
        self._put(range(len(self._columns)), start)

    def reset(self, columns: Iterable[int], start: Start | None = None, seeds: Iterable[int] | None = None) -> None:
        """Put the given columns back to `start` (default: the state the batch was made with).

        seeds: those that their disturbances begin with, default: the columns' numbers.
        """
        columns = list(columns)
        self._disturbances.reset(columns, columns if seeds is None else seeds)
        self._put(columns, self._start if start is None else start)

    def _put(self, columns: Iterable[int], start: Start) -> None:
        for column in columns:
            b, lane = self._columns[column]
            for name, lanes, order in self._parts(b, lane):
                lanes[...] = getattr(start, name)[order]

    def disturbed(self, amplitudes: np.ndarray) -> np.ndarray:
        """Return the agent's amplitudes (steps, actuators, B) with those of the disturbances, (steps, inputs, B).

        Chance draws its next numbers at every call; these do not depend on how many steps a call has.
        """
        return np.concatenate([amplitudes, self._disturbances.series(len(amplitudes))], axis=1)

    def chance(self, column: int) -> list[tuple[float, dict[str, Any]]]:
        """Return where the disturbances of a column are."""
        return self._disturbances.state(column)

    def resume(self, column: int, chance: list[tuple[float, dict[str, Any]]]) -> None:
        """Let the disturbances of a column go on from where `chance` said that they were."""
        self._disturbances.resume(column, chance)

    def advance(self, amplitudes: np.ndarray) -> np.ndarray:
        """Advance all flows by len(amplitudes) steps; amplitudes (steps, inputs, B) are held during each step.

        Returns what is read at each step, (steps, functionals, B), as `stepper.advance`. A flow that has blown up has
        non-finite numbers in its column and leaves the others alone.
        """
        expected = (len(self.ops.inputs), self.flows)
        if amplitudes.ndim != 3 or amplitudes.shape[1:] != expected:
            raise ValueError(
                f"amplitudes: expected (steps, {expected[0]}, {expected[1]}), got {amplitudes.shape}; the batch is the "
                "last axis"
            )
        given = np.zeros((*amplitudes.shape[:2], len(self._columns)))
        given[:, :, : self.flows] = amplitudes
        read, column = [], 0
        for b, width in enumerate(widths(self.flows)):
            self._blocks[b], found = stepper.advance(self.ops, self._blocks[b], given[:, :, column : column + width])
            read.append(found)
            column += width
        return np.concatenate(read, axis=2)[:, :, : self.flows].copy()

    def read(self, sensor: str) -> np.ndarray:
        """Return what a sensor reads in all flows, (B, values); of a velocity u0, v0, u1, v1, ..."""
        if sensor in self.ops.functionals:
            return self._integrals(self.ops.functionals.index(sensor))
        field, rows = self.ops.sensors[sensor]
        blocks = []
        for width, state in zip(widths(self.flows), self._blocks, strict=True):
            x, components = (state.p, 1) if field == "pressure" else (state.u, 2)
            out = simd.zeros((components, len(rows.start) - 1, 1), width)
            for component in range(components):
                kernels.product(*rows, x, component, out[component])
            blocks.append(simd.numbers(out)[:, :, 0].T.copy().reshape(width, -1))
        return np.concatenate(blocks)[: self.flows]

    def _integrals(self, k: int) -> np.ndarray:
        """Return functional k of the velocity alone as it is now, (B, 1): a shear, or the energy, which is last."""
        tables, found = self.ops.tables, []
        for width, state in zip(widths(self.flows), self._blocks, strict=True):
            u, out = simd.pairs(state.u), simd.zeros((1, 1), width)
            if k < len(tables.scale):
                start, column, value = tables.read_velocity
                kernels.divergence(start[k : k + 2], column, value, u, out)
                found.append(tables.scale[k] * simd.numbers(out)[0].T)
            else:
                room = simd.zeros((len(u), 1), 2 * width, self.ops.precision)
                kernels.energy(tables.still, *tables.energy, u, room, out, 0, 0)
                found.append(simd.numbers(out)[0].T.copy())
        return np.concatenate(found)[: self.flows]

    def state(self, column: int) -> Start:
        """Return a copy of one flow's state."""
        found: dict[str, np.ndarray] = {}
        for name, lanes, order in self._parts(*self._columns[column]):
            found[name] = np.empty(lanes.shape)
            found[name][order] = lanes
        return Start(**found)

    def velocity(self, column: int) -> np.ndarray:
        """Return a copy of one flow's velocity, (n, 2), that of its `state`."""
        b, lane = self._columns[column]
        lanes = simd.numbers(self._blocks[b].u)[..., lane]
        found = np.empty(lanes.shape)
        found[self.ops.velocity_order] = lanes
        return found

    def _parts(self, b: int, lane: int) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
        """Yield the fields of one flow by name, (n, 2) or (m,) in the solver's order, and that order."""
        for name, array in vars(self._blocks[b]).items():
            lanes = simd.numbers(array)[..., lane]
            if name in ("u", "u_old"):
                yield name, lanes, self.ops.velocity_order
            else:
                yield name, lanes[:, 0], self.ops.pressure_order


def started(ops: Operators, starts: Sequence[Start], flows: int) -> FlowBatch:
    """Return flows that begin at some states, in turn."""
    batch = FlowBatch(ops, starts[0], flows)
    for column in range(flows):
        batch.reset([column], starts[column % len(starts)])
    return batch


def recorded(
    flow: FlowBatch, amplitudes: np.ndarray, report: Callable[[str, float], None], what: str
) -> dict[str, np.ndarray]:
    """Advance flows under the agent's amplitudes (steps, actuators, B) and chance; return the readings, (steps, B)."""
    record = []
    for k in range(0, len(amplitudes), _CHUNK):
        report(what, k / len(amplitudes))
        chunk = flow.disturbed(amplitudes[k : k + _CHUNK])
        record.append(readings.named(flow.ops, flow.advance(chunk), chunk))
    report(what, 1.0)
    return readings.joined(record)


def _empty(ops: Operators, width: int) -> State:
    n, m = len(ops.velocity_order), len(ops.pressure_order)
    u, u_old, p = (simd.zeros(shape, width) for shape in ((n, 2), (n, 2), (m, 1)))
    return State(u, u_old, p, *(simd.zeros((m, 1), width, ops.precision) for _ in range(2)))
