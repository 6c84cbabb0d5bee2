"""An ellipse across the stream, twice as high as long, with a jet at each tip. Units: height 1, stream 1."""

import numpy as np

from manywake import *


def ellipse(angle):
    """Return points (k, 2) of the curve, counter-clockwise, for angles (k,) in radians."""
    return np.stack([0.25 * np.cos(angle), 0.5 * np.sin(angle)], axis=1)


CASE = Case(
    reynolds=80,
    domain=Box(x=(-8, 20), y=(-8, 8)),
    bodies=(Smooth("ellipse", ellipse, parts={"top": (75, 105), "bottom": (255, 285)}),),
    conditions=(FreeSlip("bottom", "top"), Stream("left"), Outflow("right")),
    actuators=(Jet("ellipse.top", limit=0.1), Jet("ellipse.bottom", limit=0.1)),
    sensors=(Velocity("wake", grid((1, 2, 3), (-0.75, -0.25, 0.25, 0.75))),),
)


def reward(now, free):
    """Drag saved, less a fifth of the lift."""
    return free["c_d"] - now["c_d"] - 0.2 * abs(now["c_l"])


TASK = Task(interval=0.5, actions=100, reward=reward, observe=("wake", "amplitudes"), mixing=PAIR, starts="any")
