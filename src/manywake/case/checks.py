"""What a case must fulfil: its parts fit together, or they are refused with got, wanted, remedy, before any meshing."""

import math
from collections import Counter
from typing import Any

import numpy as np

from manywake.case.conditions import Free, FreeSlip, NoSlip, Outflow
from manywake.case.geometry import distance, inside, outline

CLEAR = 1.002
"""Points keep this factor away from a body, in its own radii: its facets are parabolas, a little off the curve."""
FASTEST = 10.0
"""Largest velocity of an input, in the case's units; the time steps that a scheme allows are not stable far above."""


def check(case: Any) -> None:
    """Raise ValueError where the parts of a case do not fit together."""
    _check_numbers(case)
    _check_names(case)
    _check_bodies(case)
    _check_conditions(case)
    _check_inputs(case)
    _check_sensors(case)


def _check_numbers(case: Any) -> None:
    numbers = {"reynolds": case.reynolds, "spin_up": case.spin_up}
    numbers |= {f"scales.{name}": value for name, value in vars(case.scales).items()}
    numbers |= {f"sizes.{name}": value for name, value in vars(case.sizes).items() if name != "wake_axis"}
    for name, value in numbers.items():
        if not (0 < value < math.inf):
            raise ValueError(f"{name}: got {value:g}, wanted a positive number")
    if case.reynolds > 400:
        raise ValueError(
            f"reynolds: got {case.reynolds:g}, wanted a value in (0, 400]; the flow is two-dimensional and laminar"
        )
    largest = case.scheme.largest * case.convective_time
    if not 0 < case.dt <= largest * (1 + 1e-9):
        raise ValueError(
            f"time_step: got {case.dt:g}, wanted a value in (0, {largest:g}]; scheme {case.scheme.name!r} was never "
            "stable above"
        )


def _check_names(case: Any) -> None:
    sides = {side.name for side in case.domain.sides()}
    names = [*sorted(sides), *(body.name for body in case.bodies)]
    sensors = [sensor.name for sensor in case.sensors]
    for kind, given in (("body", names), ("sensor", sensors)):
        for name, count in Counter(given).items():
            if count > 1:
                raise ValueError(f"{kind} {name!r}: got the name {count} times, wanted a name of its own for each")
    for name in names:
        if not name or "." in name and name not in sides:
            raise ValueError(f"body {name!r}: wanted a name without a dot, which parts a body from its piece")
    pieces = [piece.name for body in case.bodies for piece in body.pieces()]
    for name in (*names, *pieces, *sensors):
        if not all(word.isidentifier() and "__" not in word for word in name.split(".")):
            raise ValueError(f"name: got {name!r}, wanted letters, digits and single _, as options are named after it")


def _check_bodies(case: Any) -> None:
    sizes, domain = case.sizes, np.array([side.start for side in case.domain.sides()])
    height = case.scales.length * sizes.layer_height * sum(sizes.layer_growth**k for k in range(int(sizes.layers)))
    if _area(domain) <= 0:
        raise ValueError("domain: runs clockwise, wanted its corners counter-clockwise, the fluid on the left")
    outlines: dict[str, np.ndarray] = {}
    for body in case.bodies:
        xy = outline(body)
        if not np.isfinite(xy).all():
            raise ValueError(f"body {body.name!r}: got points that are not finite")
        if _area(xy) <= 0:
            raise ValueError(f"body {body.name!r}: runs clockwise, wanted its points counter-clockwise")
        if not inside(domain, xy).all() or distance(domain, xy).min() < height:
            raise ValueError(
                f"body {body.name!r}: reaches the domain's boundary or lies outside, wanted it inside with room for "
                f"its layers, which are {height:g} high"
            )
        for name, other in outlines.items():
            if inside(other, xy).any() or inside(xy, other).any() or distance(other, xy).min() < 2 * height:
                raise ValueError(
                    f"body {body.name!r}: overlaps {name!r} or its layers, wanted {2 * height:g} between them"
                )
        outlines[body.name] = xy


def _area(corners: np.ndarray) -> float:
    """Return the area of a polygon (n, 2), negative if it runs clockwise."""
    x, y = corners.T
    return float(0.5 * (x * np.roll(y, -1) - np.roll(x, -1) * y).sum())


def _check_conditions(case: Any) -> None:
    sides = list(dict.fromkeys(side.name for side in case.domain.sides()))
    names = [*sides, *(body.name for body in case.bodies)]
    given = Counter(name for condition in case.conditions for name in condition.on)
    for name in given:
        if name not in names:
            raise ValueError(f"conditions: got {name!r}, wanted one of {', '.join(names)}")
    for name in names:
        if given[name] > 1:
            raise ValueError(f"conditions: {name!r} has {given[name]}, wanted exactly one")
        if name in sides and not given[name]:
            raise ValueError(f"conditions: {name!r} has none, wanted one, as NoSlip({name!r}) or Outflow({name!r})")
    for condition in case.conditions:
        body, kind = next((name for name in condition.on if name not in sides), None), type(condition).__name__
        if body is not None and not isinstance(condition, NoSlip):
            raise ValueError(f"conditions: got {kind} on the body {body!r}, wanted NoSlip, which it has unasked")
    _check_slip(case)
    net = 0.0
    for condition in () if case.outlet else case.conditions:
        for side in () if isinstance(condition, Free) else case.domain.sides():
            if side.name in condition.on:
                x = np.linspace(side.start, side.end, 3)  # Simpson's rule, exact for a parabola
                chart = side.chart(x)
                net += chart.length * (condition.velocity(side, x) * chart.outward).sum(axis=1) @ [1 / 6, 2 / 3, 1 / 6]
    if abs(net) > 1e-9 * case.scales.velocity * case.scales.length:
        raise ValueError(
            f"conditions: got a net flux of {net:g} into the domain, wanted none, as no boundary has an Outflow to let "
            "it out"
        )


def _check_slip(case: Any) -> None:
    slip = {name for condition in case.conditions if isinstance(condition, FreeSlip) for name in condition.on}
    along: dict[str, str] = {}
    for side in case.domain.sides():
        if side.name not in slip:
            continue
        off = np.abs(np.subtract(side.end, side.start))
        if off.min() > 1e-9 * off.max():
            raise ValueError(
                f"conditions: got FreeSlip on {side.name!r}, which runs from {side.start} to {side.end}, wanted a side "
                "along x or along y, where the velocity through it is one component; give it a Stream along the side"
            )
        along.setdefault("xy"[off.argmax()], side.name)
    if len(along) > 1:
        raise ValueError(
            f"conditions: got FreeSlip on {along['x']!r}, along x, and on {along['y']!r}, along y, wanted all slip "
            "sides in one direction, as one factor serves both components of the velocity and the same one is held on "
            "all; give those of one direction a Stream along them, or NoSlip"
        )


def _check_inputs(case: Any) -> None:
    bodies = [body.name for body in case.bodies]
    pieces = Counter(piece.name for body in case.bodies for piece in body.pieces())
    pieces.update(side.name for side in case.domain.sides())
    free = {name: condition for condition in case.conditions if isinstance(condition, Free) for name in condition.on}
    for name, count in Counter(actuator.on for actuator in case.actuators).items():
        if count > 1:
            raise ValueError(f"actuators: got {count} on {name!r}, wanted at most one")
    for actuator in case.actuators:
        on, kind = actuator.on, type(actuator).__name__
        if on not in pieces and on not in bodies:
            raise ValueError(f"{kind}: got the piece {on!r}, which there is not; wanted one of {', '.join(pieces)}")
        if on in free:
            what = "is an open end" if isinstance(free[on], Outflow) else "slips"
            raise ValueError(f"{kind}: {on!r} {what}, wanted a wall, where the velocity is given")
        if not 0 < actuator.limit < math.inf:
            raise ValueError(f"{kind}: got the limit {actuator.limit:g}, wanted a positive number")
        if actuator.flux is not None and (on in bodies or pieces[on] > 1):
            raise ValueError(f"{kind}: got {on!r}, wanted a single part of a body or a side, where it can blow")
        if actuator.flux is None and on not in bodies:
            raise ValueError(f"{kind}: got {on!r}, wanted the name of a body, as a whole")
        speed, fastest = _speed(case, actuator), FASTEST * case.scales.velocity
        if actuator.limit * speed > fastest:
            raise ValueError(
                f"{kind}: got the limit {actuator.limit:g}, wanted at most {fastest / speed:g}, at which {on!r} moves "
                f"the fluid {FASTEST:g} times as fast as the case's velocity"
            )


def _speed(case: Any, actuator: Any) -> float:
    """Return the largest velocity of an input at amplitude 1."""
    body, chart = case.body(actuator.on), None
    if body is None:
        side = next(side for side in case.domain.sides() if side.name == actuator.on)
        x = np.linspace(side.start, side.end, 33)
        chart = side.chart(x)
    elif actuator.on == body.name:
        x = outline(body)
    else:
        piece = next(piece for piece in body.pieces() if piece.name == actuator.on)
        x = body.point(np.linspace(piece.start, piece.end, 33)[:-1])
        chart = body.chart(piece, x)
    return float(np.linalg.norm(actuator.velocity(body, chart, x), axis=1).max())


def _check_sensors(case: Any) -> None:
    domain = np.array([side.start for side in case.domain.sides()])
    for sensor in case.sensors:
        points = np.array(sensor.points, dtype=float)
        if points.ndim != 2 or points.shape[1] != 2:
            raise ValueError(f"sensor {sensor.name!r}: got points of shape {points.shape}, wanted one (x, y) or more")
        within = np.isfinite(points).all(axis=1)
        within[within] = inside(domain, points[within]) | (distance(domain, points[within]) < 1e-12)
        where = np.where(within, "", "outside the domain")
        for body in case.bodies:
            centre = np.array(body.centre)
            hit = inside(centre + CLEAR * (outline(body) - centre), points)
            where = np.where(hit, f"inside {body.name!r}", where)
        for k in np.flatnonzero(where != ""):
            raise ValueError(
                f"sensor {sensor.name!r}: point {k} is ({points[k, 0]:g}, {points[k, 1]:g}), which is {where[k]}; "
                "wanted points in the fluid, a little off the bodies"
            )
