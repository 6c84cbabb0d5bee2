"""A flow as a picture: vorticity, bodies, actuators by their amplitude, sensors, and traces of two readings below."""

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from manywake.case.case import Case
from manywake.case.geometry import Body, outline
from manywake.case.inputs import BodyForce, Input
from manywake.case.sensors import Probes, Shear
from manywake.flow.batch import Start
from manywake.flow.raster import Raster, framed
from manywake.flow.store import Flow

WIDTH, STRIP, TITLE = 640, 88, 20
"""Of a picture, and the heights of the traces below it and of a title above it, in pixels."""
STRONGEST = 3.0
"""Vorticity, in U/L, at which the colour is full."""
FINE = 4
"""What has edges is drawn this many times larger, then averaged."""
FORCES = ("c_d", "c_l")
BODY, SENSOR, INK, FREE, TRACE = (120, 120, 120), (40, 40, 40), (60, 60, 60), (196, 78, 82), (47, 108, 159)


Traces = Sequence[tuple[float, ...]]
"""Of one flow so far: the time, then the readings that its baseline has to be shown."""


def titled(picture: np.ndarray, title: str, colour: tuple[int, int, int]) -> np.ndarray:
    """Return a picture with a line of text above it, in a strip of even height."""
    image = Image.new("RGB", (2 * picture.shape[1], 2 * TITLE), "white")
    ImageDraw.Draw(image).text((12, 5), title, fill=colour, font=ImageFont.load_default(26))
    return np.concatenate([np.asarray(image.reduce(2)), picture])


def palette(name: str) -> np.ndarray:
    """Return the 256 colours of one of matplotlib's maps, (256, 3) uint8."""
    from matplotlib import colormaps

    return (colormaps[name](np.arange(256))[:, :3] * 255).round().astype(np.uint8)


def levels(values: np.ndarray, strongest: float) -> np.ndarray:
    """Return numbers from -strongest to strongest as 0 to 255, as uint8; those beyond are cut off."""
    return np.clip(values * (127.5 / strongest) + 127.5, 0, 255).astype(np.uint8)


class Scene:
    """Draws states of one flow, (height, `WIDTH`, 3) uint8.

    duration: of the time axis of the traces, in the case's unit of time.
    """

    def __init__(self, flow: Flow, duration: float):
        self.case, self.base, self.duration = flow.case, flow.baseline, duration
        self.view = framed(flow.case, flow.baseline.mesh, WIDTH)
        self._raster = Raster(flow.operators.space, self.view)
        self._bodies = [self._patch(lambda draw, b=b: self._body(draw, b)) for b in flow.case.bodies]
        self._actuators = [self._patch(lambda draw, a=a: self._actuator(draw, a)) for a in flow.case.actuators]
        self._sensors = self._patch(self._dots)
        self._colours, self._amplitudes = palette("RdBu_r"), palette("PuOr_r")

    def frame(self, state: Start, amplitudes: np.ndarray, traces: Traces) -> np.ndarray:
        """Draw one moment and what led to it. amplitudes: (inputs,) in units of their limits."""
        return np.concatenate([self.field(state, amplitudes), self.strip(traces)])

    def field(self, state: Start, amplitudes: np.ndarray) -> np.ndarray:
        """Draw the flow at one moment, as `frame` without the traces."""
        picture = self._colours[levels(self._raster.vorticity(state) * self.case.convective_time, STRONGEST)]
        picture[~self._raster.fluid] = 255
        for patch in self._bodies:
            _blend(picture, patch, BODY)
        for patch, amplitude in zip(self._actuators, amplitudes, strict=True):
            _blend(picture, patch, self._amplitudes[levels(amplitude, 1.15)])
        _blend(picture, self._sensors, SENSOR, 0.5)
        return picture

    def strip(self, traces: Traces, beside: Traces = ()) -> np.ndarray:
        """Draw both readings against time, (STRIP, WIDTH, 3), and those of the flow beside, uncontrolled.

        Dashes: the uncontrolled mean.
        """
        image = Image.new("RGB", (2 * WIDTH, 2 * STRIP), "white")
        draw, font = ImageDraw.Draw(image), ImageFont.load_default(22)
        names = self.base.shown
        (times, *series), (_, *others) = (np.array(part).reshape(-1, 1 + len(names)).T for part in (traces, beside))
        for k, name in enumerate(names):
            left, right, top, bottom = k * WIDTH + 12, (k + 1) * WIDTH - 12, 40, 2 * STRIP - 10
            free, steady = self.base.free[name], self.base.steady[name]
            drawn = np.concatenate([series[k], others[k], [free, steady]])
            low, high = np.nanmin(drawn), np.nanmax(drawn)
            margin = 0.12 * max(high - low, 0.05 * max(abs(free), 1.0))
            scale = (bottom - top) / (high - low + 2 * margin)
            level = bottom - (free - low + margin) * scale
            for x in range(left, right, 24):
                draw.line([(x, level), (x + 12, level)], fill=FREE, width=3)
            for values, colour in ((others[k], FREE), (series[k], TRACE)):
                across = left + np.clip(times[: len(values)] / self.duration, 0.0, 1.0) * (right - left)
                points = np.stack([across, bottom - (values - low + margin) * scale], axis=1)
                points = points[np.isfinite(points).all(axis=1)]
                if len(points) > 1:
                    draw.line([(float(x), float(y)) for x, y in points], fill=colour, width=4, joint="curve")
            now = f" {series[k][-1]:.3f}" if len(times) else ""
            draw.text((left, 6), f"{name.upper() if name in FORCES else name}{now}", fill=TRACE, font=font)
            draw.text((left + 190, 6), f"uncontrolled {free:.3f}", fill=FREE, font=font)
        passed = times[-1] / self.case.convective_time if len(times) else 0.0
        draw.text((2 * WIDTH - 160, 6), f"t {passed:.1f} L/U", fill=INK, font=font)
        return np.asarray(image.reduce(2))

    def _fine(self, points: np.ndarray) -> list[tuple[float, float]]:
        return [(float(x) * FINE, float(y) * FINE) for x, y in self.view.pixels(np.asarray(points, dtype=float))]

    def _patch(self, drawn) -> tuple[slice, slice, np.ndarray]:
        """Return where what is drawn covers the picture, and how much of each pixel there, (h, w, 1) from 0 to 1."""
        image = Image.new("L", (self.view.width * FINE, self.view.height * FINE))
        drawn(ImageDraw.Draw(image))
        cover = np.asarray(image.reduce(FINE), np.float32)[:, :, None] / 255
        rows, columns = (np.flatnonzero(cover.any(axis=(axis, 2))) for axis in (1, 0))
        if not len(rows):
            return slice(0), slice(0), cover[:0, :0]
        where = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
        return *where, cover[where]

    def _body(self, draw: ImageDraw.ImageDraw, body: Body) -> None:
        draw.polygon(self._fine(outline(body)), fill=255)

    def _actuator(self, draw: ImageDraw.ImageDraw, given: Input) -> None:
        """Draw what an amplitude drives: a slot, a side, a body's rim, or where a force pushes."""
        width, joint = (3 * FINE, None) if isinstance(given, BodyForce) else (6 * FINE, "curve")
        for points in lines(self.case, given):
            draw.line(self._fine(points), fill=255, width=width, joint=joint)

    def _dots(self, draw: ImageDraw.ImageDraw) -> None:
        for sensor in self.case.sensors:
            if isinstance(sensor, Probes):
                for x, y in self._fine(np.array(sensor.points)):
                    draw.ellipse((x - FINE, y - FINE, x + FINE, y + FINE), fill=255)
            elif isinstance(sensor, Shear):
                for side in self.case.domain.sides():
                    if side.name == sensor.on:
                        draw.line(self._fine(np.array([side.start, side.end])), fill=255, width=4 * FINE)


def lines(case: Case, given: Input) -> list[np.ndarray]:
    """Return the lines, (k, 2) each, of the boundary that an input moves, or about where it acts inside the fluid."""
    if isinstance(given, BodyForce):
        angles = np.linspace(0, 2 * np.pi, 60)
        return [given.at + given.radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)]
    body = case.body(given.on)
    if body is None:
        return [np.array([side.start, side.end]) for side in case.domain.sides() if side.name == given.on]
    if given.on == body.name:
        rim = outline(body)
        return [np.concatenate([rim, rim[:1]])]
    return [body.point(np.linspace(p.start, p.end, 20)) for p in body.pieces() if p.name == given.on]


def _blend(picture: np.ndarray, patch: tuple[slice, slice, np.ndarray], colour, strength: float = 1.0) -> None:
    """Lay a colour over a picture where a patch covers it."""
    rows, columns, cover = patch
    below = picture[rows, columns]
    below[...] = below + strength * cover * (np.asarray(colour, np.float32) - below)
