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
TABLE = f"{STOJKOVIC}, Table II"
KANG = "Kang, Choi & Lee 1999: shedding stops at 1.8 U"
TURNING = (2.0,), 60.0, 180.0  # 1.0 U at the wall
FASTER = 20.0, 200.0, 0.005  # beyond the limit, so at a smaller step
REFERENCES = (
    Statistic("mean C_D", "c_d mean", 1.3371, 0.02, STOJKOVIC),
    Statistic("C_L amplitude", "c_l amplitude", 0.3259, 0.03, STOJKOVIC),
    Statistic("St", "St", 0.1650, 0.015, STOJKOVIC),
    Response("mean C_D, wall at 1.0 U", "c_d mean", 1.108, 0.02, TABLE, *TURNING),
    Response("mean C_L, wall at 1.0 U", "c_l mean", -2.504, 0.02, TABLE, *TURNING),
    Response("C_L amplitude, wall at 1.0 U", "c_l amplitude", 0.3616, None, TABLE, *TURNING),
    Response("St, wall at 1.0 U", "St", 0.1658, None, TABLE, *TURNING),
    Response("sheds, wall at 1.6 U", "sheds", 1, 0.0, KANG, (3.2,), *FASTER),
    Response("sheds, wall at 2.0 U", "sheds", 0, 0.0, KANG, (4.0,), *FASTER),
)
