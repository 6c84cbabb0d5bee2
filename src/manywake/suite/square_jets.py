"""A square cylinder in a free stream with jets at its rear edges (Xia et al. 2024, J. Fluid Mech. 981, A17).

Units: D and U. Box, jets, probes, interval and law are those of the code they released, where an episode has 400
actions. The reward is in the spirit of theirs: power saved less power spent. In coefficients, with C_P of
docs/numerics.md, eq. 17, in the place of their 2 |Q|^3 / 0.1^2, and with a penalty of a lasting lift:

    C_D0 - C_D - C_P - 0.2 |C_L|
"""

from manywake.case import *  # noqa: F403 - the words that case files are written in

SQUARE = ((-0.5, -0.5), (0.4, -0.5, "bottom"), (0.5, -0.5), (0.5, 0.5, "top"), (0.4, 0.5), (-0.5, 0.5))
BASE = tuple((0.51, round(-0.5 + k / 65, 10)) for k in range(1, 65))  # theirs are on the wall
WAKE = grid((0.75, 1.0, 1.5, 2.0, 2.5, 3.5, 4.5, 5.5), (-1.5, -1.0, -0.5, -0.25, 0.25, 0.5, 1.0, 1.5))
CASE = Case(
    reynolds=100,
    domain=Box(x=(-20.5, 26.5), y=(-12.5, 12.5)),
    bodies=(Polygon("square", SQUARE),),
    conditions=(FreeSlip("bottom", "top"), Stream("left"), Outflow("right")),
    actuators=(Jet("square.top", limit=0.1), Jet("square.bottom", limit=0.1)),
    sensors=(Pressure("wake", WAKE), Pressure("base", BASE)),
    sizes=Sizes(far=2.0),
)


def power(now, free):
    """Drag saved, less the power spent."""
    return free["c_d"] - now["c_d"] - now["power"]


def reduction(now, free):
    """Drag saved, less the power spent and a fifth of the lift."""
    return power(now, free) - 0.2 * abs(now["c_l"])


REWARDS = {"reduction": reduction, "power": power}
TASK = Task(0.5, 200, reduction, observe=("wake", "amplitudes"), mixing=PAIR, law=Linear())
LEARNING = Learning()
# manywake search --rounds 4; policies/square-jets.npz: manywake train --seed 0
CONTROLLERS = {"constant": (0.0,), "harmonic": (0.1407, 0.1288), "feedback": (-0.1029, -0.0472)}
PROTOCOLS = {"base": (replace(TASK, observe=("base", "amplitudes")), LEARNING)}

RELEASED = "Xia et al. 2024, released code"
NEWTON = "Newton, 15 to 36 thousand P2/P1 triangles, scikit-fem"
REFERENCES = (
    # not judged: theirs has facets of 0.075 on the square, and 0.45 in the wake; 25 thousand triangles have 1.4716
    Statistic("mean C_D", "c_d mean", 1.445, None, f"{RELEASED}: 1.444 to 1.446"),
    Statistic("mean C_D", "c_d mean", 1.4716, 0.005, "this mesh cut into four, at half the step"),
    Statistic("St", "St", 0.1460, 0.01, f"{RELEASED}: 1712 steps of 0.004 a period"),
    *(
        Steady(f"steady flow C_D, Re {re}", "c_d", c_d, 0.01, NEWTON, reynolds=re)
        for re, c_d in ((20, 2.322), (60, 1.481), (100, 1.2505))
    ),
    Forced(
        (0.05, -0.05, 0.1, -0.1),
        ((0.03, 0.12, 1), (0.03, 0.175, 2)),
        tolerance=0.03,
        floor=8e-3,  # half a per cent of C_D: the mesh is not its own mirror image, and so Q and -Q differ
        duration=120.0,
        settle=40.0,
    ),
)
