"""All that a case file says, as plain frozen data: the flow, the task, the learner's settings, the references.

`from manywake.case import *` gives the words that a case file is written in.
"""

from dataclasses import replace

from manywake.case.case import Case, Near, Scales, Sizes
from manywake.case.conditions import FreeSlip, NoSlip, Outflow, Parabola, Stream
from manywake.case.geometry import Box, Circle, Msh, Outline, Polygon, Smooth, grid, ring
from manywake.case.inputs import BodyForce, Gust, Jet, Noise, Rotation
from manywake.case.laws import Exponential, Held, Linear
from manywake.case.learning import Learning
from manywake.case.references import (
    Driven,
    Extremum,
    Forced,
    Growth,
    Length,
    Response,
    Settled,
    Statistic,
    Steady,
    Twin,
)
from manywake.case.schemes import BDF2, BDF2_MEAN, GODA
from manywake.case.sensors import Energy, Pressure, Shear, Velocity
from manywake.case.task import PAIR, Task, alike, balanced, pairs, twice_the_worst

__all__ = [
    "Case", "Near", "Scales", "Sizes", "replace",
    "FreeSlip", "NoSlip", "Outflow", "Parabola", "Stream",
    "Box", "Circle", "Msh", "Outline", "Polygon", "Smooth", "grid", "ring",
    "Jet", "Rotation", "Gust", "BodyForce", "Noise",
    "Pressure", "Velocity", "Shear", "Energy",
    "BDF2", "BDF2_MEAN", "GODA",
    "Task", "PAIR", "alike", "balanced", "pairs", "twice_the_worst",
    "Exponential", "Held", "Linear", "Learning",
    "Driven", "Extremum", "Forced", "Growth", "Length", "Response", "Settled", "Statistic", "Steady", "Twin",
]  # fmt: skip
