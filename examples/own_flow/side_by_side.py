"""Two cylinders side by side, one diameter apart; both turn, to calm their wakes. Units: diameter 1, stream 1."""

from manywake import *

CASE = Case(
    reynolds=60,
    domain=Box(x=(-8, 24), y=(-10, 10)),
    bodies=(Circle("upper", (0, 1.0), 0.5), Circle("lower", (0, -1.0), 0.5)),
    conditions=(FreeSlip("bottom", "top"), Stream("left"), Outflow("right")),
    actuators=(Rotation("upper", limit=1.5), Rotation("lower", limit=1.5)),
    sensors=(Velocity("wake", grid((1.5, 3, 5), (-1.5, -0.5, 0.5, 1.5))),),
)


def reward(now, free):
    """Drag saved, less the power spent and a tenth of the lift."""
    return free["c_d"] - now["c_d"] - now["power"] - 0.1 * abs(now["c_l"])


TASK = Task(
    interval=0.5, actions=120, reward=reward, observe=("wake", "c_l.upper", "c_l.lower", "amplitudes"), starts="any"
)
