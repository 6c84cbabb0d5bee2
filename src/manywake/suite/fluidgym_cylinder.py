"""FluidGym's CylinderJet2D at Re 100: the channel's cylinder with jets twice as wide, an action every quarter of D/U.

Their jets blow at up to U in the middle of 20 degrees, a parabola; ours are half a cosine with the same peak. Their
inflow is 4 % too fast in the middle, so their uncontrolled C_D is 3.328; FeatFlow's is 3.196. The agent sees the
velocity at their 151 points, two of which are there twice; they round them to a grid. They start from a random
phase with noise; here the phase is one of four. The reward is theirs, with the uncontrolled C_D of either solver:

    C_D0 - C_D - |C_L|

Units as in cylinder-jets: 10 D for lengths, 10 D/U for times.
"""

from math import pi

from manywake.case import *  # noqa: F403 - the words that case files are written in
from manywake.suite import cylinder_jets
from manywake.suite.cylinder_jets import R

JETS = {"top": (80, 100), "bottom": (260, 280)}
LIMIT = 2 / pi * 1.0 * R * pi / 9  # mean of half a cosine, peak, arc
SIDES = (-0.025, 0.025, 0.05, 0.075, 0.1)
POINTS = (
    *grid((0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45), (-0.15, -0.1, -0.05, 0.0, 0.05, 0.1, 0.15)),
    *ring(2 * R, 35),  # theirs are 36, the last where the first is
    *ring(1.25 * R, 35),
    *grid((-0.025, 0.0, 0.025, 0.05, 0.075), (-0.15, 0.15)),
    *grid(SIDES, (0.1, -0.1)),
    *grid((0.075,), (-0.05, 0.0, 0.05)),
)
CASE = replace(
    cylinder_jets.CASE,
    bodies=(Circle("cylinder", (0.0, 0.0), R, parts=JETS),),
    actuators=(Jet("cylinder.top", limit=LIMIT), Jet("cylinder.bottom", limit=LIMIT)),
    sensors=(Velocity("velocity", POINTS),),
    sizes=Sizes(wake_axis=0.005, part_facets=8),
    time_step=6.25e-4,  # at 1e-3 full jets blow it up, at 0.8 of them they do not
)


def reduction(now, free):
    """The drag saved, less the lift."""
    return free["c_d"] - now["c_d"] - abs(now["c_l"])


TASK = Task(0.025, 80, reduction, observe=("velocity",), mixing=PAIR, law=Exponential(0.1, per=1e-3), starts="any")
# policies/fluidgym-cylinder.npz: manywake train --case fluidgym-cylinder --seed 1
REFERENCES = (
    Statistic("mean C_D", "c_d mean", 3.1959, 0.005, cylinder_jets.LEVEL_6),
    Statistic("St", "St", 0.3018, 0.005, cylinder_jets.LEVEL_6),
    Statistic("mean C_D of FluidGym", "c_d mean", 3.328, None, "FluidGym's statistics at Re 100"),
)
