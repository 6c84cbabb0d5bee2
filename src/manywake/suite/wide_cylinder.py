"""A cylinder in a stream whose sides are 40 D away, for the numbers of an unbounded flow. Units: D and U."""

from manywake.case import *  # noqa: F403 - the words that case files are written in

CASE = Case(
    reynolds=100,
    domain=Box(x=(-40, 60), y=(-40, 40)),
    bodies=(Circle("cylinder", (0.0, 0.0), 0.5),),
    conditions=(FreeSlip("bottom", "top"), Stream("left"), Outflow("right")),
    actuators=(Rotation("cylinder", limit=2.0),),
    sizes=Sizes(far=4.0),
)
STOJKOVIC = "Stojkovic, Breuer & Durst 2002"
REFERENCES = (
    Statistic("mean C_D", "c_d mean", 1.3371, 0.02, STOJKOVIC),
    Statistic("C_L amplitude", "c_l max", 0.3259, 0.03, STOJKOVIC),
    Statistic("St", "St", 0.1650, 0.015, STOJKOVIC),
)
