"""The backward-facing step of Gartling 1990, Re 800: a flow for the solver alone. Units: channel height, mean inflow.

The inflow stands at the step: there is no channel before it.
"""

from manywake.case import *  # noqa: F403 - the words that case files are written in

LONG = 30.0
CASE = Case(
    reynolds=800,
    domain=Outline(
        (("floor", 0, -0.5), ("outlet", LONG, -0.5), ("ceiling", LONG, 0.5), ("inlet", 0, 0.5), ("face", 0, 0))
    ),
    conditions=(NoSlip("floor", "ceiling", "face"), Parabola("inlet", mean=1.0), Outflow("outlet")),
    sizes=Sizes(far=0.25, near=(Near("inlet", "face", size=0.04, growth=0.01),)),
    time_step=0.01,
    spin_up=40,
)
SOURCE = "Gartling 1990"
FLOOR, CEILING = ((0.0, -0.5), (LONG, -0.5)), ((0.0, 0.5), (LONG, 0.5))
REFERENCES = (
    Length("reattachment below", *FLOOR, -1, 6.10, 0.01, SOURCE),
    Length("separation above", *CEILING, -2, 4.85, 0.01, SOURCE),
    Length("reattachment above", *CEILING, -1, 10.48, 0.01, SOURCE),
)
