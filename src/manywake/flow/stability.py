"""What a flow withstands: square waves of the inputs at full strength, held at once, at the periods that hurt most.

Every sign pattern of the inputs is tried, at several phases. At a smaller step the same waves tell where the velocity
departs most from the mean flow, which is where the time stepping wants damping (docs/numerics.md, eq. 15).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from manywake.case.case import Case
from manywake.case.laws import Law
from manywake.flow import batch as batches
from manywake.flow import readings
from manywake.flow.batch import Start
from manywake.flow.operators import Operators
from manywake.flow.spinup import Progress

PERIODS = (0.8, 0.9, 1.0, 1.1, 1.25, 1.5)
"""Periods of the waves, in those of the shedding..."""
SHEDDING = 5.0
"""...or in this many L / U, where a flow is not periodic."""
RESONANT = (0.9, 1.0, 1.1)
"""Periods at which the fluctuation is measured."""
PHASES = 4
PATTERNS = 8
"""Most sign patterns that are tried; of more inputs than have so few, a choice of them."""
RISE = 0.045
"""Time within which a smooth wave makes up all but 1 / e of a jump, in L / U."""
MEASURED, TRIED, STAYING = 20.0, 40.0, 12.0
"""How long waves last to measure the fluctuation, and to be tried, and how long they then stay, in L / U."""
SHARES = (1.0, 0.8, 0.65, 0.5, 0.4, 0.3, 0.2, 0.1)
"""Shares of the strengths that are tried, until no flow blows up."""
WINDOW = 0.5
"""Time over which the readings of forced flows are averaged, in L / U."""
SAMPLES = 1200
"""Most of those averages that are kept, spread evenly over flows and times."""


@dataclass(frozen=True)
class Withstood:
    """What no flow blew up under, as shares of the actuators' strengths, and how forced flows read.

    held: waves that jump. smooth: waves that rise within `RISE`. names, samples: (windows, readings), of the forced
    flows, averaged over `WINDOW` each; at most `SAMPLES` of them.
    """

    held: float
    smooth: float
    names: tuple[str, ...]
    samples: np.ndarray

    def plain(self) -> dict[str, Any]:
        return {"held": self.held, "smooth": self.smooth, "names": list(self.names)}

    def readings(self) -> list[dict[str, float]]:
        """Return the samples as readings by name."""
        return [dict(zip(self.names, map(float, row), strict=True)) for row in self.samples]


def check(case: Case, tried: Withstood, law: Law) -> None:
    """Raise ValueError where a limit is above what flows withstood under a law as abrupt as this one."""
    one, dt = np.ones((1, 1)), case.dt
    jump = abs(np.diff(law.series(2, dt, -one, -one, one), axis=0, prepend=-one[None])).max() / 2
    smooth = jump <= _share(case, dt) * (1 + 1e-9)
    for actuator in case.actuators:
        most = actuator.strongest * (tried.smooth if smooth else tried.held)
        if actuator.limit > most * (1 + 1e-9):
            slower = "" if smooth else f", a law that takes {RISE * case.convective_time:g} to rise, as Exponential,"
            raise ValueError(
                f"limit: got {actuator.limit:g} on {actuator.on!r}, wanted at most {most:g}, the largest with which no "
                f"flow blew up under square waves{slower} or a time step below {dt:g}"
            )


def _share(case: Case, dt: float) -> float:
    """Return the share of a jump that a smooth wave makes in a step."""
    return 1.0 - float(np.exp(-dt / (RISE * case.convective_time)))


def patterns(case: Case) -> np.ndarray:
    """Return the signs (patterns, actuators) that are tried, the first one positive, without net flux if need be."""
    count = len(case.actuators)
    signs = np.array(list(product([1.0, -1.0], repeat=count)))[: max(2 ** (count - 1), 1)]
    if not case.outlet:
        flux = np.array([(actuator.flux or 0.0) * actuator.strongest for actuator in case.actuators])
        signs = signs[abs(signs @ flux) <= 1e-12 * abs(flux).max(initial=0.0)]
    return signs[np.linspace(0, len(signs) - 1, min(len(signs), PATTERNS)).round().astype(int)]


class _Waves:
    """Square waves of all patterns, phases and some periods, a flow each, for a time `waving`; then they stay.

    share: of the strengths. waving: in L / U.
    """

    def __init__(self, case: Case, shedding: float | None, periods: tuple[float, ...], share: float, waving: float):
        unit = (shedding or SHEDDING * case.convective_time) * np.array(periods)
        signs = patterns(case) * np.array([share * actuator.strongest for actuator in case.actuators])
        every = list(product(signs, unit, np.arange(PHASES) / PHASES))
        self.flows, self.amplitude = len(every), np.array([signs for signs, _, _ in every]).T
        self.period, self.phase = (np.array([part[k] for part in every], dtype=float) for k in (1, 2))
        self.waving, self.whole = waving * case.convective_time, (waving + STAYING) * case.convective_time

    def series(self, time_step: float, steps: int, rise: float) -> Iterator[np.ndarray]:
        """Yield the amplitudes (steps, actuators, flows), so many steps at a time.

        rise: share of what is missing that they make up in a step.
        """
        now = np.zeros_like(self.amplitude)
        for k in range(round(self.whole / time_step / steps)):
            t = np.minimum(time_step * (np.arange(steps) + 1 + k * steps), self.waving)
            up = (t[:, None] / self.period + self.phase + 1e-9) % 1.0 < 0.5
            series = self.amplitude * np.where(up, 1.0, -1.0)[:, None, :]
            for wanted in series:  # in place
                now = wanted[:] = now + rise * (wanted - now)
            yield series


def fluctuation(
    case: Case, ops: Operators, starts: list[Start], mean: np.ndarray, shedding: float | None
) -> np.ndarray:
    """Return the largest |u - mean| (n,) at each node under smooth waves; not finite where a flow blew up.

    ops: at a smaller step than the case's, which the flow survives without damping where the case's step needs some.
    """
    waves, largest = _Waves(case, shedding, RESONANT, 1.0, MEASURED), np.zeros(len(mean))
    batch = batches.started(ops, starts, waves.flows)
    every = max(round(0.1 * case.convective_time / ops.time_step), 1)
    for amplitudes in waves.series(ops.time_step, every, _share(case, ops.time_step)):
        batch.advance(batch.disturbed(amplitudes))
        for column in range(batch.flows):
            np.maximum(largest, np.linalg.norm(batch.velocity(column) - mean, axis=1), out=largest)
    return largest


def withstood(case: Case, ops: Operators, starts: list[Start], shedding: float | None, report: Progress) -> Withstood:
    """Return the largest share of the strengths under which no flow blows up, and the readings of the forced flows."""
    if not case.actuators:
        return Withstood(1.0, 1.0, (), np.zeros((0, 0), np.float32))
    survived: dict[str, float] = {}
    seen: list[dict[str, np.ndarray]] = []
    for name, rise in (("held", 1.0), ("smooth", _share(case, ops.time_step))):
        for share in SHARES:
            if share <= survived.get("held", 0.0):  # a smooth wave is survived where one that jumps is
                survived[name] = share
                break
            found = _tried(case, ops, starts, _Waves(case, shedding, PERIODS, share, TRIED), rise, report)
            if found:
                survived[name] = share
                seen.append(found)
                break
    names = tuple(seen[0]) if seen else ()
    samples = [np.concatenate([part[name].ravel() for part in seen]) for name in names]
    table = np.stack(samples, axis=1) if seen else np.zeros((0, 0))
    table = table[np.linspace(0, len(table) - 1, min(len(table), SAMPLES)).round().astype(int)]
    return Withstood(survived.get("held", 0.0), survived.get("smooth", 0.0), names, table.astype(np.float32))


def _tried(
    case: Case, ops: Operators, starts: list[Start], waves: _Waves, rise: float, report: Progress
) -> dict[str, np.ndarray]:
    """Return the readings (windows, flows) by name under waves; none where a flow blows up."""
    batch, found = batches.started(ops, starts, waves.flows), []
    steps = max(round(WINDOW * case.convective_time / ops.time_step), 1)
    for k, series in enumerate(waves.series(ops.time_step, steps, rise)):
        amplitudes = batch.disturbed(series)
        read = batch.advance(amplitudes)
        if readings.blown(ops, read).any():
            return {}
        found.append(readings.means(readings.named(ops, read, amplitudes)))
        report("stability", min((k + 1) * WINDOW / (TRIED + STAYING), 1.0))
    return {name: np.stack([part[name] for part in found]) for name in found[0]}
