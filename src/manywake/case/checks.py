"""What a case must fulfil: its parts fit together, or they are refused with got, wanted, remedy, before any meshing."""

import math
from collections import Counter
from typing import Any

import numpy as np

from manywake.case.conditions import Free, FreeSlip, NoSlip, Outflow
from manywake.case.geometry import distance, inside, outline
from manywake.case.inputs import Noise
from manywake.case.sensors import RESERVED, Energy, Probes, Shear

CLEAR = 1.002
"""Points keep this factor away from a body, in its own radii: its facets are parabolas, a little off the curve."""
TRIED, TRIED_EMPTY = 400.0, 1000.0
"""Largest Reynolds number of the flows that were validated, with bodies and without (`suite`)."""
CLOSEST = 1e-3
"""Least distance of bodies from each other and from the domain's sides on a mesh of the user's, in L."""
CLOSED = 1e-6
"""A curve closes whose ends are no further apart than this, as a share of its extent."""
ROUND = 1e-3
"""A body is round whose wall, as it turns, moves through itself no faster than this share of its velocity."""
FASTEST = 10.0
"""Largest velocity of an input, in the case's units; the time steps that a scheme allows are not stable far above."""
COMMON = 3.0
"""Noise is now and then so many times its rms."""


def check(case: Any) -> None:
    """Raise ValueError where the parts of a case do not fit together."""
    _check_numbers(case)
    _check_names(case)
    _check_bodies(case)
    _check_conditions(case)
    _check_inputs(case)
    _check_sensors(case)


def _check_numbers(case: Any) -> None:
    if case.mesh is not None and case.sizes != type(case.sizes)():
        raise ValueError("sizes: got some beside a mesh of your own, wanted one of the two; say sizes=Sizes()")
    numbers = {"reynolds": case.reynolds, "spin_up": case.spin_up}
    numbers |= {f"scales.{name}": value for name, value in vars(case.scales).items()}
    sizes = {name: value for name, value in vars(case.sizes).items() if name not in ("wake_axis", "near")}
    numbers |= {f"sizes.{name}": value for name, value in sizes.items()}
    for near in case.sizes.near:
        numbers |= {f"sizes.near {', '.join(near.on)}: {name}": getattr(near, name) for name in ("size", "growth")}
    for name, value in numbers.items():
        if not (0 < value < math.inf):
            raise ValueError(f"{name}: got {value:g}, wanted a positive number")
    most, which = (TRIED, "with") if case.bodies else (TRIED_EMPTY, "without")
    if case.reynolds > most:
        raise ValueError(
            f"reynolds: got {case.reynolds:g}, wanted a value in (0, {most:g}]; above none {which} bodies was tried"
        )
    largest = case.scheme.largest * case.convective_time
    if not 0 < case.dt <= largest * (1 + 1e-9):
        raise ValueError(
            f"time_step: got {case.dt:g}, wanted a value in (0, {largest:g}]; scheme {case.scheme.name!r} was never "
            "stable above"
        )


def _check_names(case: Any) -> None:
    for noise in case.disturbances:
        if not isinstance(noise, Noise):
            raise ValueError(f"disturbances: got {noise!r}, wanted Noise(...) of it, with rms and time")
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
    for name in (name for near in case.sizes.near for name in near.on):
        if name not in sides:
            raise ValueError(f"sizes.near: got {name!r}, wanted a side of the domain, of {', '.join(sorted(sides))}")
    pieces = [piece.name for body in case.bodies for piece in body.pieces()]
    forces = [given.on for given in case.inputs if given.acts == "fluid"]
    for name in (*names, *pieces, *sensors, *forces):
        if not all(word.isidentifier() and "__" not in word for word in name.split(".")):
            raise ValueError(f"name: got {name!r}, wanted letters, digits and single _, as options are named after it")


def _check_bodies(case: Any) -> None:
    sizes, domain = case.sizes, np.array([side.start for side in case.domain.sides()])
    height = case.scales.length * sizes.layer_height * sum(sizes.layer_growth**k for k in range(int(sizes.layers)))
    if case.mesh is not None:  # which needs no layers, but some room
        height = CLOSEST * case.scales.length
    if _area(domain) <= 0:
        raise ValueError("domain: runs clockwise, wanted its corners counter-clockwise, the fluid on the left")
    outlines: dict[str, np.ndarray] = {}
    for body in case.bodies:
        xy = outline(body)
        if not np.isfinite(xy).all():
            raise ValueError(f"body {body.name!r}: got points that are not finite")
        gap = 0.0 if body.straight else np.linalg.norm(np.diff(body.point(np.array([0.0, 360.0])), axis=0))
        if gap > CLOSED * np.ptp(xy, axis=0).max():
            raise ValueError(
                f"body {body.name!r}: got a curve whose ends are {gap:g} apart, wanted one that closes, whose function "
                "is the same at 0 and 2 pi"
            )
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
    given_velocity = [] if case.outlet else [c for c in case.conditions if not isinstance(c, Free)]
    net = sum(flux(case, condition, condition.on) for condition in given_velocity)
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


def flux(case: Any, condition: Any, names: tuple[str, ...]) -> float:
    """Return the flux that a velocity brings into the domain through the sides of some names."""
    net = 0.0
    for side in case.domain.sides():
        if side.name in names:
            x = np.linspace(side.start, side.end, 3)  # Simpson's rule, exact for a parabola
            chart = side.chart(x)
            net += chart.length * (condition.velocity(side, x) * chart.outward).sum(axis=1) @ [1 / 6, 2 / 3, 1 / 6]
    return net


def _check_inputs(case: Any) -> None:
    for name, count in Counter(given.on for given in case.inputs).items():
        if count > 1:
            raise ValueError(f"actuators: got {count} on {name!r}, wanted at most one, disturbances counted")
    for given in case.inputs:
        if given.acts == "fluid":
            _check_force(case, given)
        else:
            _check_place(case, given)
        if not given.limit > 0:
            raise ValueError(f"{type(given).__name__}: got the limit {given.limit:g}, wanted a positive number")
    for actuator in case.actuators:
        kind, most = type(actuator).__name__, _most(case, actuator)
        if not actuator.limit < math.inf:
            raise ValueError(
                f"{kind}: got the limit {actuator.limit:g}, wanted a finite one, of which actions are shares"
            )
        if actuator.limit > most:
            raise ValueError(f"{kind}: got the limit {actuator.limit:g}, {_wanted(most, actuator)}")
        if not actuator.limit <= actuator.strongest < math.inf:
            raise ValueError(
                f"{kind}: got the strength {actuator.strongest:g}, wanted a finite one, at least the limit "
                f"{actuator.limit:g}"
            )
    for noise in case.disturbances:
        _check_noise(case, noise)


def _check_place(case: Any, given: Any) -> None:
    """Refuse an input of the boundary that is on no wall of the kind it acts on."""
    bodies = [body.name for body in case.bodies]
    sides = Counter(side.name for side in case.domain.sides())
    pieces = Counter(piece.name for body in case.bodies for piece in body.pieces()) + sides
    free = {name: condition for condition in case.conditions if isinstance(condition, Free) for name in condition.on}
    on, kind = given.on, type(given).__name__
    if on not in pieces and on not in bodies:
        raise ValueError(f"{kind}: got the piece {on!r}, which there is not; wanted one of {', '.join(pieces)}")
    if on in free:
        what = "is an open end" if isinstance(free[on], Outflow) else "slips"
        raise ValueError(f"{kind}: {on!r} {what}, wanted a wall, where the velocity is given")
    if given.acts == "piece" and (on in bodies or pieces[on] > 1):
        raise ValueError(f"{kind}: got {on!r}, wanted a single part of a body or a side, where it can blow")
    if given.acts == "body":
        if on not in bodies:
            raise ValueError(f"{kind}: got {on!r}, wanted the name of a body, as a whole")
        _check_turning(case.body(on), given)
    if given.acts == "side":
        _check_gust(case, given, list(sides))


def _check_turning(body: Any, given: Any) -> None:
    xy = outline(body)
    along, middle = np.roll(xy, -1, axis=0) - xy, 0.5 * (np.roll(xy, -1, axis=0) + xy)
    velocity = given.velocity(body, None, middle)
    through = np.abs(along[:, 0] * velocity[:, 1] - along[:, 1] * velocity[:, 0]) / np.linalg.norm(along, axis=1)
    if through.max() > ROUND * np.linalg.norm(velocity, axis=1).max():
        raise ValueError(
            f"{type(given).__name__}: got {body.name!r}, which is not round about its centre, wanted a body that is; "
            "the mesh stands still, so that fluid would pass through the wall of another"
        )


def _check_gust(case: Any, gust: Any, sides: list[str]) -> None:
    on, profile = gust.on, gust.profile
    if on not in sides:
        raise ValueError(f"Gust: got {on!r}, wanted a side of the domain, as {', '.join(sides)}")
    if not hasattr(profile, "velocity") or getattr(profile, "on", None):
        raise ValueError(
            f"Gust: got the profile {profile!r}, wanted a given velocity without names, as Stream(x=0.0, y=1.0)"
        )
    net = 0.0 if case.outlet else flux(case, profile, (on,))
    if abs(net) > 1e-9 * case.scales.length:
        raise ValueError(
            f"Gust: got a net flux of {net:g} through {on!r} at amplitude 1, wanted none, as no boundary has an "
            "Outflow to let it out"
        )


def _check_force(case: Any, force: Any) -> None:
    names = {piece.name for body in case.bodies for piece in body.pieces()} | {body.name for body in case.bodies}
    names |= {side.name for side in case.domain.sides()}
    if force.on in names:
        raise ValueError(f"BodyForce: got the name {force.on!r}, which a piece has, wanted one of its own")
    if "." in force.on:
        raise ValueError(f"BodyForce: got the name {force.on!r}, wanted one without a dot")
    if not 0 < force.radius < math.inf:
        raise ValueError(f"BodyForce: got the radius {force.radius:g}, wanted a positive number")
    where = _where(case, np.array([force.at], dtype=float))[0]
    if where:
        at = ", ".join(f"{x:g}" for x in force.at)
        raise ValueError(f"BodyForce: {force.on!r} is at ({at}), which is {where}; wanted a point in the fluid")


def _check_noise(case: Any, noise: Any) -> None:
    on, most = noise.by.on, _most(case, noise.by)
    for name, value in (("rms", noise.rms), ("time", noise.time)):
        if not 0 < value < math.inf:
            raise ValueError(f"Noise: got the {name} {value:g} on {on!r}, wanted a positive number")
    if min(noise.by.limit, COMMON * noise.rms) > most:
        wanted = _wanted(most / COMMON, noise.by)
        raise ValueError(f"Noise: got the rms {noise.rms:g}, {wanted}, as {COMMON:g} times the rms is common")
    if noise.by.flux is not None and not case.outlet:
        raise ValueError(
            f"Noise: got a net flux through {on!r}, wanted none, as no boundary has an Outflow to let it out"
        )


def _wanted(most: float, given: Any) -> str:
    """Return what is wanted of an amplitude."""
    moves = f"moves the fluid {FASTEST:g} times as fast as the case's velocity"
    return f"wanted at most {most:g}, at which {given.on!r} {moves}"


def _most(case: Any, given: Any) -> float:
    """Return the amplitude at which an input moves the fluid `FASTEST` times as fast as the case's velocity."""
    fastest = FASTEST * case.scales.velocity
    if given.acts == "fluid":  # what crosses it along its axis gains u^2 / 2 = amplitude sqrt(pi) radius
        at_one, fastest = 2 * math.sqrt(math.pi) * given.radius * float(np.linalg.norm(given.along)), fastest**2
    else:
        at_one = _speed(case, given)
    if not 0 < at_one < math.inf:
        raise ValueError(f"{type(given).__name__}: {given.on!r} moves nothing at amplitude 1, wanted what does")
    return fastest / at_one


def _speed(case: Any, given: Any) -> float:
    """Return the largest velocity of an input of the boundary at amplitude 1."""
    body = case.body(given.on)
    if body is None:
        sides = [side for side in case.domain.sides() if side.name == given.on]
        lines = [(side, np.linspace(side.start, side.end, 33)) for side in sides]
        found = [given.velocity(side, side.chart(x), x) for side, x in lines]
    elif given.on == body.name:
        found = [given.velocity(body, None, outline(body))]
    else:
        piece = next(piece for piece in body.pieces() if piece.name == given.on)
        x = body.point(np.linspace(piece.start, piece.end, 33)[:-1])
        found = [given.velocity(body, body.chart(piece, x), x)]
    return float(np.linalg.norm(np.concatenate(found), axis=1).max())


def _check_sensors(case: Any) -> None:
    if sum(isinstance(sensor, Energy) for sensor in case.sensors) > 1:
        raise ValueError("sensors: got two of Energy, wanted one, as they would read the same")
    for sensor in case.sensors:
        if not 0 <= sensor.noise < math.inf:
            raise ValueError(f"sensor {sensor.name!r}: got the noise {sensor.noise:g}, wanted an rms, at least 0")
        if not isinstance(sensor, Probes):
            _check_integral(case, sensor)
            continue
        points = np.array(sensor.points, dtype=float)
        if points.ndim != 2 or points.shape[1] != 2:
            raise ValueError(f"sensor {sensor.name!r}: got points of shape {points.shape}, wanted one (x, y) or more")
        where = _where(case, points)
        for k in np.flatnonzero(where != ""):
            raise ValueError(
                f"sensor {sensor.name!r}: point {k} is ({points[k, 0]:g}, {points[k, 1]:g}), which is {where[k]}; "
                "wanted points in the fluid, a little off the bodies"
            )


def _check_integral(case: Any, sensor: Any) -> None:
    name, kind = sensor.name, type(sensor).__name__
    if "." in name or name in RESERVED:
        raise ValueError(
            f"sensor {name!r}: got a name for {kind} that a reading may have, wanted one without a dot, none of "
            f"{', '.join(RESERVED)}"
        )
    if not isinstance(sensor, Shear):
        return
    free = {on: condition for condition in case.conditions if isinstance(condition, Free) for on in condition.on}
    pieces = [piece.name for body in case.bodies for piece in body.pieces()]
    walls = dict.fromkeys([*(side.name for side in case.domain.sides()), *(body.name for body in case.bodies), *pieces])
    if sensor.on not in walls or sensor.on in free:
        given = ", ".join(wall for wall in walls if wall not in free)
        raise ValueError(
            f"sensor {name!r}: got the wall {sensor.on!r}, wanted one on which the velocity is given, of {given}"
        )


def _where(case: Any, points: np.ndarray) -> np.ndarray:
    """Return where each of some points (k, 2) is, if not in the fluid: a text for each, empty in the fluid."""
    domain = np.array([side.start for side in case.domain.sides()])
    within = np.isfinite(points).all(axis=1)
    within[within] = inside(domain, points[within]) | (distance(domain, points[within]) < 1e-12)
    where = np.where(within, "", "outside the domain")
    for body in case.bodies:
        centre = np.array(body.centre)
        where = np.where(inside(centre + CLEAR * (outline(body) - centre), points), f"inside {body.name!r}", where)
    return where
