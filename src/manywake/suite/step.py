"""HydroGym's backward-facing step at Re 600: steady by itself, it amplifies the noise that comes from upstream.

Units: height of the channel behind the step, peak of the inflow; Re is made with the height of the step, 1/2. The agent
blows and sucks through a slot before the edge, and sees the velocity at the wall before the slot. HydroGym's sensor is
the gauge, the friction on the floor where the flow attaches again; what that feels has passed the slot long before.
"""

from manywake.case import *  # noqa: F403 - the words that case files are written in

SLOT = Parabola(mean=2 / 9)  # at amplitude 1: peak 1/3, flux 7/90
UPSTREAM = BodyForce("upstream", at=(-1.0, 0.25), radius=0.1, along=(1.0, 1.0))
# HydroGym's is x += 0.2 (w - x) every 0.01 with w normal, of rms 1: so x has the rms 1/3 and correlation 0.8
NOISE = Noise(UPSTREAM, rms=1 / 3, time=0.045)
CASE = Case(
    reynolds=600,
    scales=Scales(length=0.5, velocity=1.0),
    domain=Outline(
        (
            ("lip", -2.5, 0.0),
            ("slot", -0.35, 0.0),
            ("face", 0.0, 0.0),
            ("floor", 0.0, -0.5),
            ("floor.gauge", 5.9, -0.5),
            ("floor", 6.1, -0.5),
            ("outlet", 25.0, -0.5),
            ("ceiling", 25.0, 0.5),
            ("inlet", -2.5, 0.5),
        )
    ),
    conditions=(
        Parabola("inlet", mean=2 / 3),
        NoSlip("lip", "slot", "face", "floor", "floor.gauge", "ceiling"),
        Outflow("outlet"),
    ),
    actuators=(Gust("slot", limit=0.1, profile=SLOT),),
    disturbances=(NOISE,),
    sensors=(Shear("gauge", "floor.gauge"), Energy("energy"), Velocity("lip", ((-0.5, 0.01),))),
    sizes=Sizes(
        far=0.3, near=(Near("slot", "face", size=0.06, growth=0.012), Near("floor.gauge", size=0.08, growth=0.05))
    ),
    time_step=0.005,
)


def calmed(now, free):
    """Share of the noise's energy that is gone, 1 - E / E_0 with E = 1/2 of the integral of |u - u_steady|^2.

    E is a mean over the action, E_0 that of the uncontrolled flow. Effort costs nothing more: what blows steadily moves
    the flow away from the steady one, and E counts that.
    """
    return 1.0 - now["energy"] / free["energy"]


TASK = Task(
    interval=0.5,
    actions=240,
    reward=calmed,
    observe=("lip",),
    history=4,
    law=Exponential(0.6321, per=0.005),  # HydroGym's lag of 0.005
    starts="any",
)
LEARNING = Learning(episodes=128, update_period=8, log_std_init=-1.7, gamma=0.98)
# policies/step.npz: manywake train --case step --seed 2
CONTROLLERS = {"constant": (-0.0179,), "harmonic": (0.5346, 0.2999), "feedback": (0.0059, 0.0308)}
REFERENCES = (Twin(("energy mean", "gauge mean", "gauge rms"), tolerance=0.05, duration=80.0, settle=40.0),)
