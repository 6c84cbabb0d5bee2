"""The fluidic pinball: three cylinders on a triangle of side 1.5, each turning, in HydroGym's box. Units: D and U.

The reward is C_D,free - C_D - C_P - |C_L| / 5, of the three cylinders together. Uncontrolled, the street has a mean
lift, up in one state and down in its mirror image; episodes begin in either.
"""

from manywake.case import *  # noqa: F403 - the words that case files are written in

BEHIND = 0.75 * 3**0.5
"""How far the rear cylinders' centres are behind the front one's."""


def cylinders(x):
    """Return the three cylinders, the front one's centre at x."""
    places = {"front": (x, 0.0), "upper": (x + BEHIND, 0.75), "lower": (x + BEHIND, -0.75)}
    return tuple(Circle(name, place, 0.5) for name, place in places.items())


CASE = Case(
    reynolds=100,
    domain=Box(x=(-6, 20), y=(-6, 6)),
    bodies=cylinders(0.0),
    conditions=(FreeSlip("bottom", "top"), Stream("left"), Outflow("right")),
    actuators=tuple(Rotation(name, limit=10) for name in ("front", "upper", "lower")),
    sensors=(Velocity("wake", grid((2.5, 3.5, 5, 7), (-1.5, -0.5, 0.5, 1.5))),),
    # it is made for walls that move at 5 U, and the step that is stable then is as small as the layers are thin
    sizes=Sizes(body=0.12, layers=2, layer_height=0.06, wake=0.24),
    time_step=1 / 400,
)


def reduction(now, free):
    """Drag saved, less the power spent and a fifth of the lift."""
    return free["c_d"] - now["c_d"] - now["power"] - 0.2 * abs(now["c_l"])


EACH = ("c_l.front", "c_l.upper", "c_l.lower")
TASK = Task(0.5, 160, reduction, ("wake", *EACH, "amplitudes"), law=Exponential(0.1, per=5e-3), starts="any")
LEARNING = Learning(  # noise of 0.7 at a limit of 10: what turns faster costs more than it can save
    log_std_init=-2.7, episodes=512, update_period=8, n_epochs=10, learning_rate=1e-3
)
CONTROLLERS = {
    "constant": (0.027, -0.2795, 0.2219),
    "harmonic": (0.0356, 0.0516, 0.0756, 0.3982, 0.6499, 0.8329),
}
# policies/pinball.npz: manywake train --case pinball --seed 2
NEWTON = "Newton, P2/P1 triangles"


def steady(reynolds, front, rear, lift):
    """Return the references of the steady flow: drag of the front and of the rear cylinders, lift of these."""
    forces = {"c_d.front": front, "c_d.upper": rear, "c_d.lower": rear, "c_l.upper": lift, "c_l.lower": -lift}
    return tuple(
        Steady(f"steady {name}, Re {reynolds}", name, value, 0.007 if "d" in name[:3] else 0.01, NEWTON, reynolds)
        for name, value in forces.items()
    )


REFERENCES = (*steady(10, 2.3575, 2.2332, 0.8777), *steady(30, 1.4914, 1.5730, 0.5268))
