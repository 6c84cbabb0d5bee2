"""Where things are: closed curves for bodies, an outline for the domain, and their pieces by name.

A body is a closed curve, run through counter-clockwise by a parameter of its own. Its `pieces()` in that order have
names: "cylinder" is what no part covers, "cylinder.top" a part. Sides of the domain have no prefix. Only this module
and the mesh know coordinates; all else names pieces.

Of every body, `point(parameter, height)` gives points (k, 2) of the curve, or of one that lies `height` outside of it;
`between(a, b)` those in the middle between points a and b (k, 2); `chart(piece, x)` where points (k, 2) of a piece are.
"""

import hashlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

Point = tuple[float, float]


@dataclass(frozen=True)
class Piece:
    """A run of a curve from one parameter to another, in the curve's own unit."""

    name: str
    start: float
    end: float


@dataclass(frozen=True)
class Chart:
    """Points of one piece by their place along it.

    offset: (k,) from the piece's middle, width: of the piece, both in one unit. length: of the piece. outward: (k, 2)
    vectors into the fluid, of any length.
    """

    offset: np.ndarray
    width: float
    length: float
    outward: np.ndarray


def grid(xs: tuple[float, ...], ys: tuple[float, ...]) -> tuple[Point, ...]:
    """Return all points of a grid, those of one x after those of another."""
    return tuple((x, y) for x in xs for y in ys)


def ring(radius: float, count: int, centre: Point = (0.0, 0.0)) -> tuple[Point, ...]:
    """Return points on a circle, evenly spread from the downstream direction on, to ten digits."""
    angles = [2 * math.pi * k / count for k in range(count)]
    points = [(centre[0] + radius * math.cos(a), centre[1] + radius * math.sin(a)) for a in angles]
    return tuple((round(x, 10), round(y, 10)) for x, y in points)  # the same on every libm


@dataclass(frozen=True)
class _Round:
    """A curve whose parameter, and that of its parts (start, end), is an angle in degrees."""

    name: str
    parts: Mapping[str, tuple[float, float]] = field(default_factory=dict, kw_only=True)
    straight = False

    def pieces(self) -> list[Piece]:
        """Raises ValueError where parts overlap."""
        if not self.parts:
            return [Piece(self.name, 0.0, 360.0)]
        named = sorted((start, end, part) for part, (start, end) in self.parts.items())
        following = [*(start for start, _, _ in named[1:]), named[0][0] + 360.0]
        pieces = []
        for (start, end, part), after in zip(named, following, strict=True):
            if not 0 < end - start < 360 or end > after:
                raise ValueError(
                    f"body {self.name!r}: got the part {part!r} from {start:g} to {end:g} degrees, wanted a rising "
                    "range that meets no other part"
                )
            pieces.append(Piece(f"{self.name}.{part}", start, end))
            if after > end:
                pieces.append(Piece(self.name, end, after))
        return pieces


@dataclass(frozen=True)
class Circle(_Round):
    """A circle; angles are in degrees from the downstream direction, counter-clockwise."""

    centre: Point
    radius: float

    def point(self, parameter: np.ndarray, height: float = 0.0) -> np.ndarray:
        angle, r = [math.radians(degrees) for degrees in np.atleast_1d(parameter)], self.radius + height
        return np.array(self.centre) + np.array([(r * math.cos(a), r * math.sin(a)) for a in angle])

    def between(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        from_centre, middle = a - self.centre, 0.5 * (a + b) - self.centre
        # the radius of the very points, to the last digit
        r = np.linalg.norm(from_centre, axis=1) / np.linalg.norm(middle, axis=1)
        return self.centre + middle * r[:, None]

    def chart(self, piece: Piece, x: np.ndarray) -> Chart:
        outward = x - np.array(self.centre)
        middle, width = np.radians(0.5 * (piece.start + piece.end)), np.radians(piece.end - piece.start)
        offset = np.angle(np.exp(1j * (np.arctan2(outward[:, 1], outward[:, 0]) - middle)))
        return Chart(offset, float(width), float(width * self.radius), outward)


@dataclass(frozen=True)
class Smooth(_Round):
    """A smooth closed curve given as a function: angles (k,) in radians -> points (k, 2), counter-clockwise.

    Parts are ranges of that angle, in degrees, wherever the points lie.
    """

    function: Callable[[np.ndarray], np.ndarray]
    centre: Point = (0.0, 0.0)

    def point(self, parameter: np.ndarray, height: float = 0.0) -> np.ndarray:
        angle = np.radians(np.atleast_1d(parameter))
        tangent = self._slope(angle) / np.linalg.norm(self._slope(angle), axis=1)[:, None]
        return np.asarray(self.function(angle)) + height * np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)

    def between(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        first, second = self._angle(a), self._angle(b)
        return np.asarray(self.function(first + 0.5 * np.angle(np.exp(1j * (second - first)))))

    def chart(self, piece: Piece, x: np.ndarray) -> Chart:
        along = np.radians(np.linspace(piece.start, piece.end, 2001))
        steps = np.linalg.norm(np.diff(np.asarray(self.function(along)), axis=0), axis=1)
        arc, middle = np.concatenate([[0.0], np.cumsum(steps)]), along[1000]
        angle = middle + np.angle(np.exp(1j * (self._angle(x) - middle)))
        outward = self.point(np.degrees(angle), 1.0) - self.point(np.degrees(angle))
        return Chart(np.interp(angle, along, arc) - 0.5 * arc[-1], arc[-1], arc[-1], outward)

    def _slope(self, angle: np.ndarray) -> np.ndarray:
        return (np.asarray(self.function(angle + 1e-5)) - np.asarray(self.function(angle - 1e-5))) / 2e-5

    def _angle(self, x: np.ndarray) -> np.ndarray:
        """Return the angles of the points of the curve that are nearest to x (k, 2)."""
        angles = np.linspace(0.0, 2 * np.pi, 4001)[:-1]
        samples = np.asarray(self.function(angles))
        angle = angles[np.linalg.norm(x[:, None] - samples[None], axis=2).argmin(axis=1)]
        for _ in range(8):  # Newton's method on the distance along the tangent
            slope = self._slope(angle)
            angle = angle + ((x - np.asarray(self.function(angle))) * slope).sum(axis=1) / (slope**2).sum(axis=1)
        return angle


def _normals(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return unit vectors (k, 2) to the right of the way from a to b."""
    along = b - a
    return np.stack([along[:, 1], -along[:, 0]], axis=1) / np.linalg.norm(along, axis=1)[:, None]


def _straight(a: np.ndarray, b: np.ndarray, x: np.ndarray, outward: float) -> Chart:
    length = float(np.linalg.norm(b - a))
    offset = (x - 0.5 * (a + b)) @ (b - a) / length
    return Chart(offset, length, length, np.tile(outward * _normals(a[None], b[None]), (len(x), 1)))


@dataclass(frozen=True)
class Polygon:
    """A body with straight sides. corners: (x, y), or (x, y, part) where the side that begins there is a part.

    Its parameter counts corners: 1.5 is the middle of the second side.
    """

    name: str
    corners: tuple[tuple, ...]
    straight = True

    @property
    def centre(self) -> Point:
        x, y = self._xy.mean(axis=0)
        return float(x), float(y)

    @property
    def _xy(self) -> np.ndarray:
        return np.array([corner[:2] for corner in self.corners], dtype=float)

    def pieces(self) -> list[Piece]:
        names = [f"{self.name}.{corner[2]}" if len(corner) > 2 else self.name for corner in self.corners]
        return [Piece(name, float(k), k + 1.0) for k, name in enumerate(names)]

    def point(self, parameter: np.ndarray, height: float = 0.0) -> np.ndarray:
        xy, parameter = self._xy, np.atleast_1d(parameter)
        after = _normals(xy, np.roll(xy, -1, axis=0))
        before = np.roll(after, 1, axis=0)
        xy = xy + height * (before + after) / (1 + (before * after).sum(axis=1))[:, None]
        side, share = parameter.astype(int) % len(xy), (parameter % 1.0)[:, None]
        return (1 - share) * xy[side] + share * xy[(side + 1) % len(xy)]

    def between(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return 0.5 * (a + b)

    def chart(self, piece: Piece, x: np.ndarray) -> Chart:
        ends = self.point(np.array([piece.start, piece.end]))
        return _straight(ends[0], ends[1], x, outward=1.0)


Body = Circle | Smooth | Polygon


@dataclass(frozen=True)
class Side:
    """A straight side of the domain, the fluid on its left."""

    name: str
    start: Point
    end: Point

    def chart(self, x: np.ndarray) -> Chart:
        return _straight(np.array(self.start), np.array(self.end), x, outward=-1.0)


@dataclass(frozen=True)
class Outline:
    """A domain with straight sides. corners: (name, x, y), a side of that name runs from there to the next corner.

    Counter-clockwise, as `sides()` are: the fluid is on the left. Several sides may share a name.
    """

    corners: tuple[tuple[str, float, float], ...]

    def sides(self) -> list[Side]:
        following = [*self.corners[1:], self.corners[0]]
        return [Side(name, (x, y), (u, v)) for (name, x, y), (_, u, v) in zip(self.corners, following, strict=True)]


@dataclass(frozen=True)
class Box:
    """A rectangle of fluid; its sides are left, right, bottom and top."""

    x: tuple[float, float]
    y: tuple[float, float]

    def sides(self) -> list[Side]:
        (x0, x1), (y0, y1) = self.x, self.y
        return Outline((("bottom", x0, y0), ("right", x1, y0), ("top", x1, y1), ("left", x0, y1))).sides()


Domain = Box | Outline


@dataclass(frozen=True)
class Msh:
    """A mesh of the user's, a .msh file of gmsh, whose groups of lines have the names of all sides and pieces.

    It is what the file holds when the case is made, wherever it lies. ValueError when there is no such file.
    """

    path: str | Path = field(compare=False)
    sha256: str = field(init=False)
    """Of the file's content."""

    def __post_init__(self) -> None:
        path = Path(self.path)
        if not path.is_file():
            raise ValueError(
                f"mesh: got {str(path)!r}, which is no file, wanted a .msh file of gmsh; make it, or give the path "
                "of one beside the case file as Path(__file__).with_name('NAME.msh')"
            )
        object.__setattr__(self, "path", str(path.resolve()))  # it is read later, maybe from another folder
        object.__setattr__(self, "sha256", hashlib.sha256(path.read_bytes()).hexdigest())


def outline(body: Body, height: float = 0.0, count: int = 720) -> np.ndarray:
    """Return points (n, 2) around a body, `height` outside of it: its corners if it is straight, else `count`."""
    if body.straight:
        return body.point(np.array([piece.start for piece in body.pieces()]), height)
    return body.point(np.linspace(0.0, 360.0, count + 1)[:-1], height)


def inside(polygon: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return which points (k, 2) lie within a polygon (n, 2), by the number of sides to the right of each."""
    (x, y), a, b = points.T[..., None], polygon, np.roll(polygon, -1, axis=0)
    crosses = (a[:, 1] > y) != (b[:, 1] > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = a[:, 0] + (y - a[:, 1]) * (b[:, 0] - a[:, 0]) / (b[:, 1] - a[:, 1])
    return (crosses & (x < at)).sum(axis=1) % 2 == 1


def distance(polygon: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the distances (k,) of points (k, 2) from the sides of a polygon (n, 2)."""
    along = np.roll(polygon, -1, axis=0) - polygon
    share = ((points[:, None] - polygon) * along).sum(axis=2) / (along**2).sum(axis=1)
    return np.linalg.norm(points[:, None] - polygon - np.clip(share, 0.0, 1.0)[..., None] * along, axis=2).min(axis=1)
