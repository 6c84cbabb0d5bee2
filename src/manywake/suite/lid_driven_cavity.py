"""A square cavity under a moving lid at Re 1000: a flow for the solver alone. Units: side and lid's velocity."""

from manywake.case import *  # noqa: F403 - the words that case files are written in

CASE = Case(
    reynolds=1000,
    domain=Box(x=(0, 1), y=(0, 1)),
    conditions=(Stream("top"), NoSlip("left", "right", "bottom")),  # the corners are at rest: nothing leaks
    sizes=Sizes(far=0.05, near=(Near("top", "left", "bottom", "right", size=0.02, growth=0.14),)),
    time_step=0.005,
    spin_up=40,
)
SOURCE = "Botella & Peyret 1998, 160 Chebyshev modes"
MIDDLE, FLOOR = ((0.5, 0.0), (0.5, 1.0)), ((0.0, 0.5), (1.0, 0.5))
REFERENCES = (
    Extremum("least u on the vertical axis", "u min", *MIDDLE, -0.3885698, 0.003, SOURCE),
    Extremum("largest v on the horizontal axis", "v max", *FLOOR, 0.3769447, 0.003, SOURCE),
    Extremum("least v on the horizontal axis", "v min", *FLOOR, -0.5270771, 0.003, SOURCE),
)
