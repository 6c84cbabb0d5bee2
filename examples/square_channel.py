# ruff: noqa: F403, F405
"""A square cylinder between slip sides 20 D apart, a blockage of 5 %, at Re 100 and 200, for the solver.

Units: D and U. The numbers are those of the finest grids of Sohankar, Norberg & Davidson 1998 (Int. J. Numer. Meth.
Fluids 26, 39), as public repositories that read its tables give them. The outlet is 26 D behind the square, as in its
Table II. How far in front its inlet is was not found; here it is 10 D. So the numbers are shown, not judged. Their
three grids at Re 100 have C_D 1.460 to 1.478 and rms C_L 0.139 to 0.156. Run it with
manywake validate --case examples/square_channel.py (half an hour the first time).
"""

from manywake import *

CASE = Case(
    reynolds=100,
    domain=Box(x=(-10.5, 26.5), y=(-10, 10)),
    bodies=(Polygon("square", ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))),),
    conditions=(FreeSlip("bottom", "top"), Stream("left"), Outflow("right")),
    sizes=Sizes(far=2.5),
)
SOHANKAR = "Sohankar, Norberg & Davidson 1998, finest grid"
NUMBERS = {100: (1.478, 0.146, 0.153), 200: (1.462, 0.150, 0.377)}
REFERENCES = tuple(
    Statistic(f"{name}, Re {re}", of, value, None, SOHANKAR, re)
    for re, values in NUMBERS.items()
    for (name, of), value in zip((("mean C_D", "c_d mean"), ("St", "St"), ("rms C_L", "c_l rms")), values, strict=True)
)
