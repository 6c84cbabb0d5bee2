# ruff: noqa: F403, F405
"""The DFG benchmark 2D-3: the channel's cylinder in a stream that swells and stops, sin(pi t / 8), for the solver.

Units as in cylinder-jets: 10 D for lengths, 10 D/U for times. Re 100 is reached at t = 4. Run it with
manywake validate --case examples/dfg_2d_3.py (some minutes).
"""

import math

from manywake import *
from manywake.suite import cylinder_jets
from manywake.suite.cylinder_jets import R

CASE = replace(
    cylinder_jets.CASE,
    bodies=(Circle("cylinder", (0.0, 0.0), R),),
    conditions=(NoSlip("bottom", "top", "left"), Outflow("right")),
    actuators=(Gust("left", 0.01, Parabola(mean=1.0)),),  # the references drive it to 1
    sensors=(),
    sizes=Sizes(wake_axis=0.005, body=0.04, wake=0.113, far=0.25),
    scheme=BDF2,
    time_step=5e-4,
    spin_up=40,
)


def swell(t):
    """The mean inflow."""
    return (math.sin(math.pi * t / 8),)


JOHN = "John 2004"
ENDS = ((-R, 0.0), (R, 0.0))
REFERENCES = (
    Driven("C_D max", "c_d max", 2.950921575, 0.005, JOHN, swell, 8.0),
    Driven("C_L max", "c_l max", 0.47795, 0.005, JOHN, swell, 8.0),
    Driven("pressure difference at t = 8", "pressure drop", -0.1116, 0.005, JOHN, swell, 8.0, ENDS),
)
