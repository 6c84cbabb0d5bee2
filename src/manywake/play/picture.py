"""What a page draws of a flow: fields on a regular grid in 8 bits, and where bodies, actuators and sensors are.

Lengths are in L, fields in units of L, U and rho.
"""

import struct
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.ndimage import distance_transform_edt

from manywake.case.geometry import outline
from manywake.case.sensors import Probes
from manywake.env.scene import STRONGEST, lines
from manywake.flow.batch import Start
from manywake.flow.raster import Raster, framed
from manywake.flow.store import Flow

WIDTH = 448
"""Of the grid."""
HEADER = struct.Struct("<4sIHBBHHHH")
"""Of a frame: MAGIC, its number, that of its layout, the field, lanes, width, height, how many numbers, flags (0)."""
MAGIC = b"wake"


@dataclass(frozen=True)
class Shade:
    """A field that can be drawn, from `low` (0) to `high` (255). diverging: the middle is a value to depart from."""

    name: str
    label: str
    low: float
    high: float
    diverging: bool


class Picture:
    """The fields of one case on a grid of `width` points across, those of bodies and walls like the nearest fluid."""

    def __init__(self, flow: Flow, width: int = WIDTH):
        self.flow, self.view = flow, framed(flow.case, flow.baseline.mesh, width)
        self._raster = Raster(flow.operators.space, self.view)
        nearest = distance_transform_edt(~self._raster.fluid, return_distances=False, return_indices=True)
        self._nearest = np.ravel_multi_index(tuple(nearest), self._raster.fluid.shape).ravel()
        scales, start = flow.case.scales, flow.baseline.start
        self._draw = {
            "vorticity": (self._raster.vorticity, flow.case.convective_time),
            "pressure": (self._raster.pressure, 2.0 / scales.velocity**2),
            "speed": (self._raster.speed, 1.0 / scales.velocity),
        }
        p, speed = (self._values(name, start)[self._raster.fluid] for name in ("pressure", "speed"))
        middle, (least, most) = float(np.median(p)), np.percentile(p, (0.3, 99.7))
        reach = 1.1 * max(middle - float(least), float(most) - middle)
        self.shades = (
            Shade("vorticity", "vorticity ω L/U", -STRONGEST, STRONGEST, True),
            Shade("pressure", "pressure 2p/ρU²", middle - reach, middle + reach, True),
            Shade("speed", "speed |u|/U", 0.0, 1.05 * float(np.percentile(speed, 99.9)), False),
        )

    def _values(self, name: str, state: Start) -> np.ndarray:
        draw, unit = self._draw[name]
        return draw(state) * unit

    def levels(self, shade: Shade, state: Start) -> np.ndarray:
        """Return a field, (height, width) uint8; what is no number counts as 0."""
        scaled = (self._values(shade.name, state) - shade.low) * (255.0 / (shade.high - shade.low))
        found = np.clip(np.nan_to_num(scaled) + 0.5, 0, 255).astype(np.uint8)
        return found.ravel()[self._nearest].reshape(found.shape)

    def frame(self, number: int, layout: int, which: int, states: Sequence[Start], numbers: Sequence[float]) -> bytes:
        """Return a frame: header, numbers as singles, then each state's field, row by row from the top.

        layout: number of the layout that tells what the numbers are. which: place of the field among `shades`.
        """
        width, height = self.view.width, self.view.height
        head = HEADER.pack(MAGIC, number, layout, which, len(states), width, height, len(numbers), 0)
        fields = [self.levels(self.shades[which], state).tobytes() for state in states]
        return b"".join([head, np.array(numbers, "<f4").tobytes(), *fields])

    def described(self) -> dict[str, Any]:
        """Return what a page has to know to draw frames."""
        case, unit = self.flow.case, self.flow.case.scales.length
        sensors = [(sensor.name, sensor.points) for sensor in case.sensors if isinstance(sensor, Probes)]
        return {
            "view": {"x": _plain(self.view.x, unit), "y": _plain(self.view.y, unit)},
            "domain": _plain([side.start for side in case.domain.sides()], unit),
            "bodies": [_plain(outline(body, count=120), unit) for body in case.bodies],
            "actuators": [
                {"name": given.on, "lines": [_plain(line, unit) for line in lines(case, given)]}
                for given in case.actuators
            ],
            "sensors": [{"name": name, "points": _plain(points, unit)} for name, points in sensors],
            "fields": [asdict(shade) for shade in self.shades],
        }


def _plain(numbers: Any, unit: float) -> list:
    return np.round(np.asarray(numbers, dtype=float) / unit, 4).tolist()
