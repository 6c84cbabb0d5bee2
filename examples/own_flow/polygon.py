"""A wedge, its edge upstream, with a jet amid its base that blows or sucks. Units: height of the base 1, stream 1."""

from manywake import *

WEDGE = Polygon("wedge", ((-0.75, 0), (0, -0.5), (0, -0.1, "jet"), (0, 0.1), (0, 0.5)))  # "jet" begins at its corner

CASE = Case(
    reynolds=80,
    domain=Box(x=(-8, 20), y=(-8, 8)),
    bodies=(WEDGE,),
    conditions=(FreeSlip("bottom", "top"), Stream("left"), Outflow("right")),
    actuators=(Jet("wedge.jet", limit=0.1),),
    sensors=(Velocity("wake", grid((1, 2, 3), (-0.75, -0.25, 0.25, 0.75))),),
    time_step=0.005,  # half the default, for the sharp corners
)


def reward(now, free):
    """Drag saved, less a fifth of the lift."""
    return free["c_d"] - now["c_d"] - 0.2 * abs(now["c_l"])


TASK = Task(interval=0.5, actions=100, reward=reward, observe=("wake", "amplitudes"), starts="any")
