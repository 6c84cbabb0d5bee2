"""A cylinder in a free stream that turns about its axis, in the box of HydroGym's cylinder. Units: D and U."""

from manywake.case import *  # noqa: F403 - the words that case files are written in
from manywake.suite import free_cylinder_jets
from manywake.suite.free_cylinder_jets import REFERENCES, reduction

__all__ = ["CASE", "CONTROLLERS", "REFERENCES", "TASK"]

CASE = replace(free_cylinder_jets.CASE, actuators=(Rotation("cylinder", limit=1.5708),))  # pi / 2: 0.785 U at the wall
TASK = Task(0.25, 160, reduction, observe=("pressure", "amplitudes"), law=Exponential(0.1, per=5e-3))
# manywake search --rounds 4; policies/free-cylinder-rotation.npz: manywake train --seed 1
CONTROLLERS = {"constant": (-0.0315,), "harmonic": (0.1267, 0.1485), "feedback": (-0.0949, -0.0903)}
