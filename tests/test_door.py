"""The door: what does not fit is refused with got, wanted and a remedy, before anything is meshed or written."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from manywake.case import Exponential, Jet, Pressure, replace
from manywake.suite import load
from manywake.suite.cylinder_jets import CASE, TASK

JETS = "cylinder.top", "cylinder.bottom"
PARTS = {
    "scales": "length=0.1",
    "domain": "Box(x=(-0.2, 1.0), y=(-0.2, 0.21))",
    "bodies": 'Circle("cylinder", (0.0, 0.0), 0.05, parts={"top": (85, 95), "bottom": (265, 275)})',
    "conditions": 'NoSlip("bottom", "top"), Parabola("left", mean=1.0), Outflow("right")',
    "actuators": 'Jet("cylinder.top", limit=0.01), Jet("cylinder.bottom", limit=0.01)',
    "sensors": 'Pressure("pressure", ((0.1, 0.0), (0.2, 0.05)))',
    "case": "",
    "reward": 'free["c_d"] - now["c_d"]',
    "task": "",
    "observe": '"pressure",',
    "mixing": "PAIR",
    "below": "",
}
"""The parts of a case file that is as it should be."""


def file(**changes: str) -> str:
    """Return a case file, as it should be or with some of its parts changed."""
    assert set(changes) <= set(PARTS)
    part = PARTS | changes
    return f"""import numpy as np
from manywake import *

CASE = Case(
    reynolds=100,
    scales=Scales({part["scales"]}),
    domain={part["domain"]},
    bodies=({part["bodies"]},),
    conditions=({part["conditions"]},),
    actuators=({part["actuators"]},),
    sensors=({part["sensors"]},),
    {part["case"]}
)


def reward(now, free):
    return {part["reward"]}


TASK = Task(0.025, 80, reward, observe=({part["observe"]}), mixing={part["mixing"]}, {part["task"]})
{part["below"]}
"""


def around(corners: str) -> dict[str, str]:
    """Return the parts of a file whose body has straight sides and no jets."""
    return {"bodies": f'Polygon("wedge", {corners})', "actuators": 'Gust("left", limit=0.1)', "mixing": "None"}


def curve(function: str, **changes: str) -> dict[str, str]:
    """Return the parts of a file whose body is a curve, given as a function of a, without jets."""
    body = f'Smooth("wing", lambda a: np.stack([{function}], axis=1))'
    plain = {"bodies": body, "actuators": 'Gust("left", limit=0.1)', "mixing": "None"}
    return plain | changes


def force(words: str) -> dict[str, str]:
    """Return the parts of a file whose only actuator is a force."""
    return {"actuators": f"BodyForce({words})", "mixing": "None"}


def noise(words: str, **changes: str) -> str:
    """Return a file with a disturbance."""
    return file(case=f"disturbances=({words},)", **changes)


def test_the_file_that_the_rows_change_is_let_in(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(file())
    chosen = load.choose(path)
    assert (chosen.definition.name, chosen.case.bodies[0].name, chosen.task.actions) == ("mine", "cylinder", 80)
    path.write_text(file(**around("((0.0, -0.05), (0.08, 0.0), (0.0, 0.05))")))
    assert load.choose(path).case.bodies[0].name == "wedge"
    path.write_text(file(**force('"push", 500.0, at=(0.2, 0.0), radius=0.05')))
    assert load.choose(path).case.actuators[0].on == "push"
    # noise that its input cuts off may have any rms, and a disturbance needs no limit
    path.write_text(noise('Noise(Gust("left"), rms=3.0, time=0.1), Noise(Jet("top", 0.01), rms=9.0, time=0.1)'))
    assert [given.on for given in load.choose(path).case.inputs] == [*JETS, "left", "top"]
    # a jet's net flux needs an open end, a pair's does not, nor does a stream that goes out as it comes in
    path.write_text(file(conditions='NoSlip("bottom", "top"), Stream("left", "right")'))
    assert not load.choose(path).case.outlet
    # and a slip side lets nothing through, so it counts for none of the flux
    path.write_text(file(conditions='FreeSlip("bottom", "top"), Stream("left", "right")'))
    assert load.choose(path).case.conditions[0].on == ("bottom", "top")


FILES = {
    "a file that does not compile": ("from manywake import *\n\nCASE = Case(\n", "mine.py, line 3, fails (SyntaxError"),
    "a file that raises": (
        "import math\n\nx = 1 / 0\n",
        "mine.py, line 3, fails (ZeroDivisionError: division by zero)",
    ),
    "a file that imports what there is not": ("import no_such_module\n", "line 1, fails (ModuleNotFoundError"),
    "a file without a case": ("x = 1\n", "mine.py has nothing as CASE, wanted CASE = Case(...)"),
    "a file whose case is none": ("CASE = 100\n", "mine.py has int as CASE, wanted CASE = Case(...)"),
    "a file without a task": (
        file(below="del TASK"),
        "mine.py, wanted TASK = Task(...) to train, evaluate or play with; validate and baseline do without",
    ),
    "a task that is none": (file(below="TASK = reward"), "mine.py has function as TASK, wanted TASK = Task(...)"),
    "a protocol that is none": (
        file(below='PROTOCOLS = {"long": TASK}'),
        "as the protocol 'long', wanted (Task(...), Learning(...))",
    ),
    # ---- the domain and its bodies
    "a boundary without a condition": (
        file(conditions='NoSlip("bottom"), Parabola("left"), Outflow("right")'),
        "conditions: 'top' has none, wanted one, as NoSlip('top') or Outflow('top')",
    ),
    "a boundary with two conditions": (
        file(conditions='NoSlip("bottom", "top", "left"), Parabola("left"), Outflow("right")'),
        "conditions: 'left' has 2, wanted exactly one",
    ),
    "a condition on a boundary that is not there": (
        file(conditions='NoSlip("bottom", "top"), Parabola("inlet"), Outflow("right")'),
        "conditions: got 'inlet', wanted one of bottom, right, top, left, cylinder",
    ),
    "a parabola around a body": (
        file(conditions='NoSlip("bottom", "top"), Parabola("left", "cylinder"), Outflow("right")'),
        "conditions: got Parabola on the body 'cylinder', wanted NoSlip, which it has unasked",
    ),
    "free slip around a body": (
        file(conditions='NoSlip("bottom", "top"), FreeSlip("cylinder"), Parabola("left"), Outflow("right")'),
        "conditions: got FreeSlip on the body 'cylinder', wanted NoSlip, which it has unasked",
    ),
    "free slip on sides of two directions": (
        file(conditions='FreeSlip("bottom", "left"), Stream("top"), Outflow("right")'),
        "conditions: got FreeSlip on 'bottom', along x, and on 'left', along y, wanted all slip sides in one "
        "direction, as one factor serves both components of the velocity",
    ),
    "free slip on a slanted side": (
        file(
            domain='Outline((("bottom", -0.2, -0.2), ("right", 1, -0.2), ("top", 1, 0.3), ("left", -0.2, 0.2)))',
            conditions='FreeSlip("bottom", "top"), Stream("left"), Outflow("right")',
        ),
        "conditions: got FreeSlip on 'top', which runs from (1, 0.3) to (-0.2, 0.2), wanted a side along x or along y",
    ),
    "a setting that a condition has not": (
        file(conditions='NoSlip("bottom", "top"), Parabola("left", peak=1.5), Outflow("right")'),
        "fails (TypeError: Parabola() got an unexpected keyword argument 'peak')",
    ),
    "bodies that overlap": (
        file(bodies='Circle("front", (0.0, 0.0), 0.05), Circle("cylinder", (0.08, 0.0), 0.05)'),
        "body 'cylinder': overlaps 'front' or its layers, wanted 0.0270984 between them",
    ),
    "a body within another": (
        file(bodies='Circle("front", (0.0, 0.0), 0.05), Circle("cylinder", (0.0, 0.0), 0.01)'),
        "body 'cylinder': overlaps 'front'",
    ),
    "a body that reaches the boundary": (
        file(bodies='Circle("cylinder", (0.0, 0.15), 0.05)'),
        "body 'cylinder': reaches the domain's boundary or lies outside, wanted it inside with room for its layers",
    ),
    "a body outside of the domain": (
        file(bodies='Circle("cylinder", (5.0, 0.0), 0.05)'),
        "body 'cylinder': reaches the domain's boundary or lies outside",
    ),
    "a body that is not finite": (
        file(bodies='Circle("cylinder", (0.0, float("nan")), 0.05)'),
        "body 'cylinder': got points that are not finite",
    ),
    "a polygon that runs clockwise": (
        file(**around("((0.0, -0.05), (0.0, 0.05), (0.1, 0.0))")),
        "body 'wedge': runs clockwise, wanted its points counter-clockwise",
    ),
    "a curve that does not close": (
        file(**curve("(0.05 + 0.001 * a) * np.cos(a), 0.05 * np.sin(a)")),
        "body 'wing': got a curve whose ends are 0.00628319 apart, wanted one that closes",
    ),
    "a curve that turns and is not round": (
        file(**curve("0.05 * np.cos(a), 0.03 * np.sin(a)", actuators='Rotation("wing", limit=1.0)')),
        "Rotation: got 'wing', which is not round about its centre, wanted a body that is; the mesh stands still",
    ),
    "a polygon that turns": (
        file(**around("((0.0, -0.05), (0.08, 0.0), (0.0, 0.05))") | {"actuators": 'Rotation("wedge", limit=1.0)'}),
        "Rotation: got 'wedge', which is not round about its centre",
    ),
    "a domain that runs clockwise": (
        file(
            domain='Outline((("left", -0.2, -0.2), ("top", -0.2, 0.2), ("right", 1.0, 0.2), ("bottom", 1.0, -0.2)))',
        ),
        "domain: runs clockwise, wanted its corners counter-clockwise, the fluid on the left",
    ),
    "a box the wrong way round": (
        file(domain="Box(x=(1.0, -0.2), y=(-0.2, 0.21))"),
        "domain: runs clockwise, wanted its corners counter-clockwise, the fluid on the left",
    ),
    "parts that overlap": (
        file(bodies='Circle("cylinder", (0.0, 0.0), 0.05, parts={"top": (85, 95), "bottom": (90, 100)})'),
        "body 'cylinder': got the part 'top' from 85 to 95 degrees, wanted a rising range that meets no other part",
    ),
    "two bodies of one name": (
        file(bodies='Circle("cylinder", (0.0, 0.0), 0.02), Circle("cylinder", (0.3, 0.0), 0.02)'),
        "body 'cylinder': got the name 2 times, wanted a name of its own for each",
    ),
    "a body named as a side": (
        file(bodies='Circle("top", (0.0, 0.0), 0.05)'),
        "body 'top': got the name 2 times, wanted a name of its own for each",
    ),
    "a body with a dot in its name": (
        file(bodies='Circle("cylinder.top", (0.0, 0.0), 0.05)'),
        "body 'cylinder.top': wanted a name without a dot",
    ),
    "a name that is no word": (
        file(bodies='Circle("my cylinder", (0.0, 0.0), 0.05)'),
        "name: got 'my cylinder', wanted letters, digits and single _, as options are named after it",
    ),
    "a part whose name is no word": (
        file(bodies='Circle("cylinder", (0.0, 0.0), 0.05, parts={"top-jet": (85, 95)})'),
        "name: got 'cylinder.top-jet', wanted letters, digits and single _, as options are named after it",
    ),
    "a sensor whose name is no word": (
        file(sensors='Pressure("far-wake", ((0.1, 0.0),))'),
        "name: got 'far-wake', wanted letters, digits and single _, as options are named after it",
    ),
    # ---- actuators
    "an actuator on a piece that no body has": (
        file(actuators='Jet("cylinder.left", limit=0.01)'),
        "Jet: got the piece 'cylinder.left', which there is not; wanted one of cylinder.top, cylinder, cylinder.bottom",
    ),
    "an actuator on a body that is not there": (
        file(actuators='Rotation("sphere", limit=1.0)'),
        "Rotation: got the piece 'sphere', which there is not; wanted one of cylinder.top",
    ),
    "a rotation of a part": (
        file(actuators='Rotation("cylinder.top", limit=1.0)'),
        "Rotation: got 'cylinder.top', wanted the name of a body, as a whole",
    ),
    "a rotation of a side": (
        file(actuators='Rotation("top", limit=1.0)'),
        "Rotation: got 'top', wanted the name of a body, as a whole",
    ),
    "a jet on a whole body": (
        file(actuators='Jet("cylinder", limit=0.01)'),
        "Jet: got 'cylinder', wanted a single part of a body or a side, where it can blow",
    ),
    "an actuator on an open end": (
        file(actuators='Jet("right", limit=0.01)'),
        "Jet: 'right' is an open end, wanted a wall, where the velocity is given",
    ),
    "an actuator on a slip side": (
        file(conditions='FreeSlip("bottom", "top"), Parabola("left"), Outflow("right")', actuators='Jet("top", 0.01)'),
        "Jet: 'top' slips, wanted a wall, where the velocity is given",
    ),
    "two actuators on one piece": (
        file(actuators='Jet("cylinder.top", limit=0.01), Jet("cylinder.top", limit=0.02)'),
        "actuators: got 2 on 'cylinder.top', wanted at most one",
    ),
    "a negative limit": (
        file(actuators='Jet("cylinder.top", limit=-0.01)'),
        "Jet: got the limit -0.01, wanted a positive number",
    ),
    "a limit that is not a number": (
        file(actuators='Jet("cylinder.top", limit=float("nan"))'),
        "Jet: got the limit nan, wanted a positive number",
    ),
    "a limit past all measure": (
        file(actuators='Jet("cylinder.top", limit=0.06)'),
        "Jet: got the limit 0.06, wanted at most 0.0555556, at which 'cylinder.top' moves the fluid 10 times as fast",
    ),
    "a strength below the limit": (
        file(actuators='Jet("cylinder.top", limit=0.01, strength=0.005)', mixing="None"),
        "Jet: got the strength 0.005, wanted a finite one, at least the limit 0.01",
    ),
    "a strength without end": (
        file(actuators='Jet("cylinder.top", limit=0.01, strength=float("inf"))', mixing="None"),
        "Jet: got the strength inf, wanted a finite one, at least the limit 0.01",
    ),
    "a rotation past all measure": (
        file(actuators='Rotation("cylinder", limit=201.0)'),
        "Rotation: got the limit 201, wanted at most 200, at which 'cylinder' moves the fluid 10 times as fast",
    ),
    "a limit that is not given": (
        file(actuators='Jet("cylinder.top")', mixing="None"),
        "Jet: got the limit inf, wanted a finite one, of which actions are shares",
    ),
    "a gust on a body": (
        file(actuators='Gust("cylinder", 0.1)', mixing="None"),
        "Gust: got 'cylinder', wanted a side of the domain, as bottom, right, top, left",
    ),
    "a gust at an open end": (
        file(actuators='Gust("right", 0.1)', mixing="None"),
        "Gust: 'right' is an open end, wanted a wall, where the velocity is given",
    ),
    "a gust that is named twice": (
        file(actuators='Gust("left", 0.1, Stream("left"))', mixing="None"),
        "Gust: got the profile Stream(on=('left',), x=1.0, y=0.0), wanted a given velocity without names",
    ),
    "a gust that is open": (
        file(actuators='Gust("left", 0.1, Outflow())', mixing="None"),
        "wanted a given velocity without names, as Stream(x=0.0, y=1.0)",
    ),
    "a gust of nothing": (
        file(actuators='Gust("left", 0.1, NoSlip())', mixing="None"),
        "Gust: 'left' moves nothing at amplitude 1, wanted what does",
    ),
    "a gust past all measure": (
        file(actuators='Gust("left", 7.0, Parabola(mean=1.0))', mixing="None"),
        "Gust: got the limit 7, wanted at most 6.66667, at which 'left' moves the fluid 10 times as fast",
    ),
    "a gust with a net flux without an open end": (
        file(
            actuators='Gust("left", 0.1)', conditions='NoSlip("bottom", "top"), Stream("left", "right")', mixing="None"
        ),
        "Gust: got a net flux of 0.41 through 'left' at amplitude 1, wanted none, as no boundary has an Outflow",
    ),
    "a force named as a piece": (
        file(**force('"top", 0.1, at=(0.2, 0.0), radius=0.05')),
        "BodyForce: got the name 'top', which a piece has, wanted one of its own",
    ),
    "a force named as a part": (
        file(**force('"cylinder.left", 0.1, at=(0.2, 0.0), radius=0.05')),
        "BodyForce: got the name 'cylinder.left', wanted one without a dot",
    ),
    "a force whose name is no word": (
        file(**force('"push it", 0.1, at=(0.2, 0.0), radius=0.05')),
        "name: got 'push it', wanted letters, digits and single _, as options are named after it",
    ),
    "a force inside a body": (
        file(**force('"push", 0.1, at=(0.01, 0.0), radius=0.05')),
        "BodyForce: 'push' is at (0.01, 0), which is inside 'cylinder'; wanted a point in the fluid",
    ),
    "a force outside of the domain": (
        file(**force('"push", 0.1, at=(0.1, 0.5), radius=0.05')),
        "BodyForce: 'push' is at (0.1, 0.5), which is outside the domain; wanted a point in the fluid",
    ),
    "a force of no extent": (
        file(**force('"push", 0.1, at=(0.2, 0.0), radius=0.0')),
        "BodyForce: got the radius 0, wanted a positive number",
    ),
    "a force of no direction": (
        file(**force('"push", 0.1, at=(0.2, 0.0), radius=0.05, along=(0.0, 0.0)')),
        "BodyForce: 'push' moves nothing at amplitude 1, wanted what does",
    ),
    "a force past all measure": (
        file(**force('"push", 600.0, at=(0.2, 0.0), radius=0.05')),
        "BodyForce: got the limit 600, wanted at most 564.19, at which 'push' moves the fluid 10 times as fast",
    ),
    # ---- disturbances
    "a disturbance without noise": (
        noise('BodyForce("push", 1.0, at=(0.2, 0.0), radius=0.05)'),
        "strength=None, at=(0.2, 0.0), radius=0.05, along=(1.0, 0.0)), wanted Noise(...) of it, with rms and time",
    ),
    "a disturbance on an actuator": (
        noise('Noise(Jet("cylinder.top"), rms=0.001, time=0.1)'),
        "actuators: got 2 on 'cylinder.top', wanted at most one, disturbances counted",
    ),
    "a disturbance of what there is not": (
        noise('Noise(Gust("inlet"), rms=0.1, time=0.1)'),
        "Gust: got the piece 'inlet', which there is not; wanted one of cylinder.top, cylinder",
    ),
    "noise of no size": (
        noise('Noise(Gust("left"), rms=0.0, time=0.1)'),
        "Noise: got the rms 0 on 'left', wanted a positive number",
    ),
    "noise of no time": (
        noise('Noise(Gust("left"), rms=0.1, time=float("nan"))'),
        "Noise: got the time nan on 'left', wanted a positive number",
    ),
    "noise past all measure": (
        noise('Noise(Gust("left"), rms=4.0, time=0.1)'),
        "Noise: got the rms 4, wanted at most 3.33333, at which 'left' moves the fluid 10 times as fast as the case's "
        "velocity, as 3 times the rms is common",
    ),
    "noise with a net flux without an open end": (
        noise('Noise(Jet("top"), rms=0.1, time=0.1)', conditions='NoSlip("bottom", "top"), Stream("left", "right")'),
        "Noise: got a net flux through 'top', wanted none, as no boundary has an Outflow to let it out",
    ),
    "no actuator": (
        file(below="CASE = replace(CASE, actuators=())"),
        "actuators: got none, wanted at least one that the agent drives",
    ),
    # ---- sensors
    "a sensor inside a body": (
        file(sensors='Pressure("pressure", ((0.1, 0.0), (0.01, 0.02)))'),
        "sensor 'pressure': point 1 is (0.01, 0.02), which is inside 'cylinder'; wanted points in the fluid",
    ),
    "a sensor outside of the domain": (
        file(sensors='Velocity("pressure", ((0.1, 0.3),))'),
        "sensor 'pressure': point 0 is (0.1, 0.3), which is outside the domain; wanted points in the fluid",
    ),
    "a sensor at no number": (
        file(sensors='Pressure("pressure", ((0.1, float("nan")),))'),
        "sensor 'pressure': point 0 is (0.1, nan), which is outside the domain",
    ),
    "a sensor without points": (
        file(sensors='Pressure("pressure", ())'),
        "sensor 'pressure': got points of shape (0,), wanted one (x, y) or more",
    ),
    "a sensor at a point of space": (
        file(sensors='Pressure("pressure", ((0.1, 0.0, 0.0), (0.2, 0.0, 0.0)))'),
        "sensor 'pressure': got points of shape (2, 3), wanted one (x, y) or more",
    ),
    "two sensors of one name": (
        file(sensors='Pressure("pressure", ((0.1, 0.0),)), Velocity("pressure", ((0.1, 0.0),))'),
        "sensor 'pressure': got the name 2 times, wanted a name of its own for each",
    ),
    "a sensor named as a reading": (
        file(sensors='Pressure("c_d", ((0.1, 0.0),))', observe='"c_d",'),
        "sensor 'c_d': got the name of a reading, wanted another",
    ),
    "a sensor named as the amplitudes": (
        file(sensors='Pressure("amplitudes", ((0.1, 0.0),))', observe='"amplitudes",'),
        "sensor 'amplitudes': got the name of a reading, wanted another",
    ),
    # ---- the task
    "a mixing matrix with a row too few": (
        file(mixing="((1.0,),)"),
        "mixing: got a matrix of shape (1, 1), wanted 2 rows of finite numbers, one for each input",
    ),
    "a mixing matrix for more inputs": (
        file(mixing="pairs(2)"),
        "mixing: got a matrix of shape (4, 2), wanted 2 rows of finite numbers",
    ),
    "a mixing vector": (file(mixing="(1.0, -1.0)"), "mixing: got a matrix of shape (2,), wanted 2 rows"),
    "a mixing of nothing": (file(mixing="((0.0,), (0.0,))"), "mixing: got a matrix of shape (2, 1), wanted 2 rows"),
    "a mixing that is not finite": (
        file(mixing='((1.0,), (float("nan"),))'),
        "mixing: got a matrix of shape (2, 1), wanted 2 rows of finite numbers",
    ),
    "a reward of a reading that there is not": (
        file(reward='now["lift"]'),
        "reward: reward asks for 'lift', wanted readings of this case: c_d, c_l, c_m, c_d.cylinder",
    ),
    "a reward that is a text": (file(reward='"much"'), "reward: reward returned 'much', wanted a finite number"),
    "a reward that is no number": (
        file(reward='float("nan")'),
        "reward: reward returned nan, wanted a finite number",
    ),
    "a reward that is an array": (
        file(reward='__import__("numpy").ones(3)'),
        "reward: reward returned array([1., 1., 1.]), wanted a finite number",
    ),
    "a reward of nothing": (file(reward="None"), "reward: reward returned None, wanted a finite number"),
    "a reward that raises": (
        file(reward='1.0 / (now["c_d"] - now["c_d"])'),
        "reward: reward fails on finite readings (ZeroDivisionError",
    ),
    "a reward of one argument": (
        file(task="", below="TASK = replace(TASK, reward=lambda now: 1.0)"),
        "reward: <lambda> fails on finite readings (TypeError",
    ),
    "a reward that is no function": (
        file(below="TASK = replace(TASK, reward=1.0)"),
        "reward: got 1.0, wanted a function reward(now, free)",
    ),
    "a charge that is no number": (
        file(task='charge=lambda reward, forced, free: "all"'),
        "charge: <lambda> returned 'all', wanted a finite number",
    ),
    "a law that is none": (
        file(task='law="exponential"'),
        "law: got 'exponential', wanted an object, as Held() or Linear()",
    ),
    "net flux without an open end": (
        file(conditions='NoSlip("bottom", "top", "left", "right")', mixing="alike(2)"),
        "mixing: got a net flux of up to 0.02, wanted none, as no boundary has an Outflow to let it out",
    ),
    "an inflow without an open end": (
        file(conditions='NoSlip("bottom", "top", "right"), Parabola("left", mean=1.0)'),
        "conditions: got a net flux of 0.41 into the domain, wanted none, as no boundary has an Outflow to let it out",
    ),
    "an observation of what there is not": (
        file(observe='"vorticity",'),
        "observe: got 'vorticity', wanted some of pressure, c_d, c_l, c_m, c_d.cylinder",
    ),
    "an observation of nothing": (file(observe=""), "observe: got nothing, wanted some of pressure"),
    "an observation as a text": (
        file(observe='"pressure"'),
        "observe: got 'pressure', wanted a tuple of names, as ('pressure',)",
    ),
    "an interval between time steps": (
        file(below="TASK = replace(TASK, interval=0.0252)"),
        "interval: got 0.0252, wanted a multiple of the time step 0.001; the nearest is 0.025",
    ),
    # ---- numbers
    "a Reynolds number that was not tried": (
        file(below="CASE = replace(CASE, reynolds=500)"),
        "reynolds: got 500, wanted a value in (0, 400]; above none with bodies was tried",
    ),
    "a time step too long": (file(case="time_step=2e-3"), "time_step: got 0.002, wanted a value in (0, 0.00125]"),
    "a time step that depends on the scheme": (
        file(case="time_step=1e-3, scheme=GODA"),
        "time_step: got 0.001, wanted a value in (0, 0.0006]; scheme 'goda' was never stable above",
    ),
    "a length of nothing": (file(scales="length=0.0"), "scales.length: got 0, wanted a positive number"),
    "a size of nothing": (file(case="sizes=Sizes(body=0.0)"), "sizes.body: got 0, wanted a positive number"),
}
"""A case file, and what is said of it."""


@pytest.mark.parametrize("row", FILES)
def test_a_file_is_refused(row, tmp_path):
    content, message = FILES[row]
    path = tmp_path / "mine.py"
    path.write_text(content)
    meshed = "gmsh" in sys.modules
    with pytest.raises(ValueError) as caught:
        load.choose(path)
    assert message in str(caught.value)
    assert ("gmsh" in sys.modules) == meshed


@pytest.mark.parametrize(
    ("case", "message"),
    [
        ("nowhere.py", "case: got nowhere.py, which is no file, wanted the path of a case file"),
        ("nowhere/", f"case: got 'nowhere/', wanted one of {', '.join(load.names())}, or the path of a .py file"),
        ("sphere", f"case: got 'sphere', wanted one of {', '.join(load.names())}, or the path of a .py file"),
        (CASE, "task: got none, wanted task=Task(...) beside a case that is made in Python"),
    ],
)
def test_a_case_that_is_not_there_is_refused(case, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for door in (load.load, load.choose):
        with pytest.raises(ValueError) as caught:
            door(case)
        assert message in str(caught.value)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"task": "easy"}, "protocol: got 'easy', wanted one of default, paper, code"),
        ({"smoothing": 0.1}, "got the setting 'smoothing', wanted one of actions, actuators, batch_size"),
        ({"limit.cylinder.left": 0.01}, "got the setting 'limit.cylinder.left', wanted one of"),
        ({"points.velocities": ((0.1, 0.0),)}, "got the setting 'points.velocities', wanted one of"),
        ({"sizes.nose": 0.1}, "got the setting 'sizes.nose', wanted one of"),
        ({"law.beta": 0.1}, "got the setting 'law.beta', wanted one of"),
        ({"reward": "money"}, "reward: got 'money', wanted one of reduction, paper, paper-offset, code, drag"),
        ({"law": "pid"}, "law: got 'pid', wanted one of linear, held, exponential"),
        ({"scheme": "rk4"}, "scheme: got 'rk4', wanted one of bdf2-mean, bdf2, goda"),
        (
            {"scheme": "bdf2", "time_step": 1e-3},
            "time_step: got 0.001, wanted a value in (0, 0.0006]; scheme 'bdf2' was never stable",
        ),
        ({"observe": ("pressure", "vorticity")}, "observe: got 'vorticity', wanted some of pressure, velocity, c_d"),
        ({"observe": "pressure"}, "observe: got 'pressure', wanted a tuple of names, as ('pressure',)"),
        ({"limit": -0.01}, "Jet: got the limit -0.01, wanted a positive number"),
        ({"limit.cylinder.top": 0.0}, "Jet: got the limit 0, wanted a positive number"),
        ({"points.pressure": ((0.0, 0.0),)}, "sensor 'pressure': point 0 is (0, 0), which is inside 'cylinder'"),
        ({"interval": 0.0252}, "interval: got 0.0252, wanted a multiple of the time step 0.001; the nearest is 0.025"),
        ({"interval": 0.0}, "interval: got 0, wanted a positive time"),
        ({"actions": 1}, "actions: got 1, wanted at least 2"),
        ({"law.alpha": 1.5}, "alpha: got 1.5, wanted a value in (0, 1]"),
        ({"law": "linear", "law.alpha": 0.2}, "law.alpha: got 0.2, wanted none, as Linear has no alpha"),
        ({"reynolds": 0.0}, "reynolds: got 0, wanted a positive number"),
        ({"reynolds": 401.0}, "reynolds: got 401, wanted a value in (0, 400]"),
        ({"time_step": 1.26e-3}, "time_step: got 0.00126, wanted a value in (0, 0.00125]; scheme 'bdf2-mean' was"),
        ({"time_step": 0.0}, "time_step: got 0, wanted a value in (0, 0.00125]"),
        ({"spin_up": -1.0}, "spin_up: got -1, wanted a positive number"),
        ({"mixing": ((1.0, 1.0),)}, "mixing: got a matrix of shape (1, 2), wanted 2 rows"),
        ({"reward": lambda now, free: now["c_d.rear"]}, "reward: <lambda> asks for 'c_d.rear', wanted readings of"),
        ({"update_period": 16, "episodes": 20}, "episodes: got 20, wanted a multiple of the update period 16"),
    ],
)
def test_a_setting_is_refused(settings, message):
    with pytest.raises(ValueError) as caught:
        load.choose("cylinder-jets", **settings)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: replace(CASE, reynolds=-1.0), "reynolds: got -1, wanted a positive number"),
        (lambda: replace(CASE, conditions=()), "conditions: 'bottom' has none, wanted one"),
        (lambda: replace(CASE, actuators=(Jet("cylinder", 0.01),)), "Jet: got 'cylinder', wanted a single part"),
        (lambda: replace(CASE, sensors=(Pressure("p", ((9.0, 0.0),)),)), "which is outside the domain"),
        (lambda: Exponential(0.0, per=1.0), "alpha: got 0, wanted a value in (0, 1]"),
        (lambda: Exponential(0.1, per=0.0), "per: got 0, wanted a positive time"),
        (lambda: replace(TASK, actions=1), "actions: got 1, wanted at least 2"),
        (lambda: replace(TASK, interval=-1.0), "interval: got -1, wanted a positive time"),
    ],
)
def test_what_is_made_in_python_is_refused_where_it_is_made(make, message):
    with pytest.raises(ValueError) as caught:
        make()
    assert message in str(caught.value)


# ---- the same through the command line


def train(*words: str, folder: Path) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "manywake.cli", "train", "--run", str(folder / "run"), *words]
    environment = os.environ | {"XDG_CACHE_HOME": str(folder / "cache")}
    return subprocess.run(command, capture_output=True, text=True, check=False, env=environment, timeout=60)


def assert_refused(done: subprocess.CompletedProcess, message: str, folder: Path) -> None:
    assert done.returncode == 2, done.stderr
    assert done.stdout == ""
    (line,) = done.stderr.splitlines()
    assert line.startswith("error: ") and message in line
    assert not (folder / "run").exists()  # and so nothing was learnt
    assert not (folder / "cache" / "manywake" / "baselines").exists()  # and so nothing was meshed


@pytest.mark.parametrize(
    "row",
    [
        "a file that raises",
        "a file without a task",
        "a boundary without a condition",
        "a rotation of a part",
        "a sensor inside a body",
        "a polygon that runs clockwise",
        "a reward of a reading that there is not",
        "net flux without an open end",
    ],
)
def test_a_file_is_refused_by_the_command_line_in_one_line(row, tmp_path):
    content, message = FILES[row]
    path = tmp_path / "mine.py"
    path.write_text(content)
    assert_refused(train("--case", str(path), folder=tmp_path), message, tmp_path)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--case", "nowhere.py"], "case: got nowhere.py, which is no file, wanted the path of a case file"),
        (["--protocol", "easy"], "protocol: got 'easy', wanted one of default, paper, code"),
        (["--interval", "0.0252"], "interval: got 0.0252, wanted a multiple of the time step 0.001"),
        (["--law", "linear", "--law.alpha", "0.2"], "law.alpha: got 0.2, wanted none, as Linear has no alpha"),
    ],
)
def test_a_setting_is_refused_by_the_command_line_in_one_line(words, message, tmp_path):
    assert_refused(train(*words, folder=tmp_path), message, tmp_path)
