# ruff: noqa: F403, F405
"""The channel's cylinder with four jets and a Reynolds number of each episode's own (Tang et al. 2020).

Units as of cylinder-jets: 10 D, the mean inflow U. One mesh serves Re 100 to 400; the agent is not told which it is.
Four baselines are made at the first use. None was finished yet: each takes more than half an hour of a core, as strong
jets want small steps at Re 400, and it may withstand less than 0.008. Nothing was trained. The layers are as at Re 100,
as thinner ones want smaller steps still (docs/mesh-and-stability.md).
"""

from manywake import *
from manywake.suite import channel, cylinder_jets
from manywake.suite.cylinder_jets import R

JETS = {"right_top": (70, 80), "left_top": (100, 110), "left_bottom": (250, 260), "right_bottom": (280, 290)}
PROBES = (
    *grid((0.075, *(0.05 * k for k in range(2, 13)), 0.7, 0.8, 0.9, 1.0), (-0.15, -0.1, -0.05, 0.0, 0.05, 0.1, 0.15)),
    *grid((-0.025, 0.0, 0.025, 0.05), (-0.15, -0.1, 0.1, 0.15)),
    *(point for off in (0.002, 0.02, 0.05) for point in ring(R + off, 36)),
)
CASE = replace(
    cylinder_jets.CASE,
    reynolds=400,
    bodies=(Circle("cylinder", (0.0, 0.0), R, parts=JETS),),
    actuators=tuple(Jet(f"cylinder.{name}", limit=0.008) for name in JETS),
    sensors=(Pressure("pressure", PROBES),),
    sizes=Sizes(body=0.045, part_facets=2, layers=3, wake=0.113, wake_axis=0.005),
    time_step=2.5e-4,
)


def reward(now, free):
    """Drag saved, less a fifth of the lift: Tang's reward, against the uncontrolled flow of the same Re."""
    return free["c_d"] - now["c_d"] - 0.2 * abs(now["c_l"])


NUMBERS = (100, 200, 300, 400)
TASK = Task(0.01, 200, reward, ("pressure",), mixing=balanced(4), law=Linear(), reynolds_numbers=NUMBERS, starts="any")
REFERENCES = tuple(each for each in channel.REFERENCES if each.reynolds in NUMBERS)  # on this mesh
