"""A cylinder in a free stream with two jets of zero net flux, in the box of HydroGym's cylinder. Units: D and U."""

from manywake.case import *  # noqa: F403 - the words that case files are written in

WAKE = (*grid((1.0, 1.5, 2.0, 3.0, 4.0, 5.0), (-1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5)), *ring(0.7, 24))
CASE = Case(
    reynolds=100,
    domain=Box(x=(-5, 15), y=(-5, 5)),
    bodies=(Circle("cylinder", (0.0, 0.0), 0.5, parts={"top": (85, 95), "bottom": (265, 275)}),),
    conditions=(FreeSlip("bottom", "top"), Stream("left"), Outflow("right")),
    actuators=(Jet("cylinder.top", limit=0.1), Jet("cylinder.bottom", limit=0.1)),
    sensors=(Pressure("pressure", WAKE), Velocity("velocity", WAKE)),
)


def reduction(now, free):
    """Drag saved, less the power spent and half the lift."""
    return free["c_d"] - now["c_d"] - now["power"] - 0.5 * abs(now["c_l"])


TASK = Task(0.25, 160, reduction, observe=("pressure",), mixing=PAIR, law=Exponential(0.1, per=5e-3))
# manywake search, feedback with --rounds 16; policies/free-cylinder-jets.npz: manywake train --seed 2
CONTROLLERS = {"constant": (-0.0001,), "harmonic": (0.1408, 0.1526), "feedback": (-0.1277, 0.0101)}
NEWTON = "Newton, 15 to 36 thousand P2/P1 triangles, scikit-fem"
REFERENCES = tuple(
    Steady(f"steady flow C_D, Re {re}", "c_d", c_d, 0.005, NEWTON, reynolds=re)
    for re, c_d in ((20, 2.4220), (60, 1.5329), (100, 1.2861))
)
