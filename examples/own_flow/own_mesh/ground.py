"""A cylinder one diameter above a ground that moves with the stream, two jets, on the mesh of make_mesh.py.

Units: diameter 1, stream 1.
"""

from pathlib import Path

from manywake import *

CASE = Case(
    reynolds=100,
    domain=Box(x=(-8, 20), y=(-1.5, 8)),
    bodies=(Circle("cylinder", (0, 0), 0.5, parts={"top": (80, 100), "bottom": (260, 280)}),),
    conditions=(FreeSlip("top"), Stream("left", "bottom"), Outflow("right")),
    actuators=(Jet("cylinder.top", limit=0.1), Jet("cylinder.bottom", limit=0.1)),
    sensors=(Velocity("wake", grid((1, 2, 3), (-0.75, -0.25, 0.25, 0.75))),),
    mesh=Msh(Path(__file__).with_name("ground.msh")),
)


def reward(now, free):
    """Drag saved, less what the lift changes."""
    return free["c_d"] - now["c_d"] - 0.2 * abs(now["c_l"] - free["c_l"])


TASK = Task(interval=0.5, actions=100, reward=reward, observe=("wake", "amplitudes"), mixing=PAIR, starts="any")
