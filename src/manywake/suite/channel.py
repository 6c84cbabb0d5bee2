"""The channel's cylinder without jets, Re 40 to 400, on sizes for the last of them: for the solver alone.

Mean drag against Tang et al. 2020, read off their figure to 0.02; steady drag against Newton's method on fine meshes.
"""

from manywake.case import *  # noqa: F403 - the words that case files are written in
from manywake.suite import cylinder_jets

PLAIN = (Circle("cylinder", (0.0, 0.0), cylinder_jets.R),)
SIZES = Sizes.at(400, wake_axis=0.005)  # layers as thin as Re 400 wants them
CASE = replace(cylinder_jets.CASE, bodies=PLAIN, actuators=(), sensors=(), sizes=SIZES)
TANG = "Tang et al. 2020, read off a figure"
NEWTON = "Newton, 15 to 36 thousand P2/P1 triangles"
MEAN = {40: 4.03, 60: 3.515, 80: 3.31, 100: 3.205, 200: 3.145, 300: 3.16, 400: 3.17}
STEADY = {60: 3.4556, 100: 2.9415, 150: 2.6590, 200: 2.5067, 250: 2.4030, 300: 2.319, 350: 2.248, 400: 2.190}
REFERENCES: tuple[Steady | Statistic, ...] = (
    *(Steady(f"steady C_D, Re {re}", "c_d", c_d, 0.005, NEWTON, re) for re, c_d in STEADY.items()),
    *(Statistic(f"mean C_D, Re {re}", "c_d mean", c_d, 0.015, TANG, re) for re, c_d in MEAN.items()),
)
