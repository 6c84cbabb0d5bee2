"""A batch of flows: B columns that start from given states, advance together and are read together."""

from dataclasses import dataclass

import numpy as np

from manywake.flow import stepper
from manywake.flow.factors import Rows
from manywake.flow.kernels import product
from manywake.flow.operators import Operators
from manywake.flow.stepper import State
from manywake.machine import simd


@dataclass(frozen=True)
class Start:
    """One flow's state in scikit-fem's order, independent of any elimination order and batch.

    u, u_old: (n, 2). p, phi, phi_old: (m,).
    """

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
    """B independent flows of one case. A flow's numbers do not depend on B, on its column, or on its neighbours."""

    def __init__(self, ops: Operators, start: Start, flows: int):
        if flows < 1:
            raise ValueError(f"flows: got {flows}, wanted at least 1")
        self.ops = ops
        self.flows = flows
        self._start = start
        self._blocks = [_empty(ops, width) for width in widths(flows)]
        self._columns = [(b, lane) for b, width in enumerate(widths(flows)) for lane in range(width)]
        for b, lane in self._columns:
            _write(ops, self._blocks[b], lane, start)

    def reset(self, columns: np.ndarray | list[int], start: Start | None = None) -> None:
        """Put the given columns back to `start` (default: the state the batch was made with)."""
        for column in columns:
            b, lane = self._columns[column]
            _write(self.ops, self._blocks[b], lane, self._start if start is None else start)

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
        steps = len(amplitudes)
        read = np.empty((steps, len(self.ops.functionals), self.flows))
        column = 0
        for b, state in enumerate(self._blocks):
            width = simd.numbers(state.u).shape[-1]
            count = min(width, self.flows - column)
            given = np.zeros((steps, expected[0], width))
            given[:, :, :count] = amplitudes[:, :, column : column + count]
            self._blocks[b], found = stepper.advance(self.ops, state, given)
            read[:, :, column : column + count] = found[:, :, :count]
            column += count
        return read

    def read(self, sensor: str) -> np.ndarray:
        """Return what a sensor reads in all flows, (B, values); of a velocity u0, v0, u1, v1, ..."""
        field, rows = self.ops.sensors[sensor]
        return np.concatenate([_read(field, rows, state) for state in self._blocks])[: self.flows]

    def state(self, column: int) -> Start:
        """Return a copy of one flow's state."""
        b, lane = self._columns[column]
        return read_state(self.ops, self._blocks[b], lane)


def _read(field: str, rows: Rows, state: State) -> np.ndarray:
    x, components = (state.p, (0,)) if field == "pressure" else (state.u, (0, 1))
    parts = []
    for component in components:
        out = simd.zeros((len(rows.start) - 1, 1), simd.numbers(x).shape[-1])
        product(*rows, x, component, out)
        parts.append(np.ascontiguousarray(simd.numbers(out)[:, 0].T))
    return np.stack(parts, axis=2).reshape(len(parts[0]), -1)


def _empty(ops: Operators, width: int) -> State:
    n, m = len(ops.velocity_order), len(ops.pressure_order)
    u, u_old, p = (simd.zeros(shape, width) for shape in ((n, 2), (n, 2), (m, 1)))
    return State(u, u_old, p, *(simd.zeros((m, 1), width, ops.precision) for _ in range(2)))


def _write(ops: Operators, state: State, lane: int, start: Start) -> None:
    for name in ("u", "u_old"):
        simd.numbers(getattr(state, name))[:, :, lane] = getattr(start, name)[ops.velocity_order]
    for name in ("p", "phi", "phi_old"):
        simd.numbers(getattr(state, name))[:, 0, lane] = getattr(start, name)[ops.pressure_order]


def read_state(ops: Operators, state: State, lane: int) -> Start:
    """Return one lane of a block as a `Start`."""
    parts: dict[str, np.ndarray] = {}
    for name in ("u", "u_old"):
        parts[name] = np.empty((len(ops.velocity_order), 2))
        parts[name][ops.velocity_order] = simd.numbers(getattr(state, name))[:, :, lane]
    for name in ("p", "phi", "phi_old"):
        parts[name] = np.empty(len(ops.pressure_order))
        parts[name][ops.pressure_order] = simd.numbers(getattr(state, name))[:, 0, lane]
    return Start(**parts)
