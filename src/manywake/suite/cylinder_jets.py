"""A cylinder with two jets in the DFG channel (Schafer & Turek 1996; Rabault & Kuhnle 2019).

The unit of length is 10 D, of velocity the mean inflow U, of time 10 D/U; a shedding period is 0.33.
"""

from manywake.case import *  # noqa: F403 - the words that case files are written in

R = 0.05
PROBES = (
    *grid((0.075, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45), (-0.15, -0.1, -0.05, 0.0, 0.05, 0.1, 0.15)),
    *grid((-0.025, 0.0, 0.025, 0.05), (-0.15, -0.1, 0.1, 0.15)),
    *ring(R + 0.02, 36),
    *ring(R + 0.05, 36),
)
CASE = Case(
    reynolds=100,
    scales=Scales(length=2 * R, velocity=1.0),
    domain=Box(x=(-0.2, 2.0), y=(-0.2, 0.21)),
    bodies=(Circle("cylinder", (0.0, 0.0), R, parts={"top": (85, 95), "bottom": (265, 275)}),),
    conditions=(NoSlip("bottom", "top"), Parabola("left", mean=1.0), Outflow("right")),
    actuators=(Jet("cylinder.top", limit=0.01), Jet("cylinder.bottom", limit=0.01)),
    sensors=(Pressure("pressure", PROBES), Velocity("velocity", PROBES)),
    sizes=Sizes(wake_axis=0.005),
    scheme=BDF2_MEAN,
)


def reduction(now, free):
    """Drag saved, less half the lift; with a weight of 0.2 two of two seeds kept a biased jet (docs/results.md)."""
    return free["c_d"] - now["c_d"] - 0.5 * abs(now["c_l"])


def paper(now, free):
    """Eq. 1 of the paper."""
    return -now["c_d"] - abs(now["c_l"])


def code(now, free):
    """What the paper's released code does, in its units (force = C / 20)."""
    return 0.159 - now["c_d"] / 20 - 0.2 * abs(now["c_l"]) / 20


REWARDS = {
    "reduction": reduction,
    "paper": paper,
    "paper-offset": lambda now, free: free["c_d"] - now["c_d"] - abs(now["c_l"]),
    "code": code,
    "drag": lambda now, free: -now["c_d"],
    "drag-offset": lambda now, free: free["c_d"] - now["c_d"],
}
TASK = Task(0.025, 160, reduction, observe=("pressure",), mixing=PAIR, law=Exponential(0.1, per=5e-4))
LEARNING = Learning()
# 400 episodes, constant step 1e-3, 25 minibatches of a fifth of the batch an update, as the released code has them
RELEASED = Learning(20, 400, 1e-3, 1e-3, batch_size=320, ent_coef=0.01, log_std_init=-1.0, hidden=(512, 512))
PROTOCOLS = {
    "paper": (replace(TASK, actions=80, reward=paper), RELEASED),
    "code": (replace(TASK, actions=80, reward=code, law=Linear()), RELEASED),
}
# manywake search --controller NAME; policies/cylinder-jets.npz: manywake train --seed 2
CONTROLLERS = {"constant": (-0.0134,), "harmonic": (0.5347, 0.3701), "feedback": (-0.0844, -0.1627)}

FEATFLOW, LEVEL_6 = "Schafer & Turek 1996, FeatFlow", "FeatFlow Q2/P1 level 6, dt 1/1600"
DROP = ((-R, 0.0), (R, 0.0), 0.2**2, (0.11752, 0.01))  # the benchmark's mean inflow is 0.2
REFERENCES = (
    Settled("DFG 2D-1", 20.0, {"c_d": (5.5795, 0.005), "c_l": (0.010619, 0.05)}, FEATFLOW, pressure_drop=DROP),
    Statistic("DFG 2D-2 c_D max", "c_d max", 3.2274, 0.005, LEVEL_6),
    Statistic("DFG 2D-2 c_D mean", "c_d mean", 3.1959, 0.005, LEVEL_6),
    Statistic("DFG 2D-2 c_L max", "c_l max", 0.9866, 0.015, LEVEL_6),
    Statistic("DFG 2D-2 St", "St", 0.3018, 0.005, LEVEL_6),
    Steady("steady base flow C_D", "c_d", 2.942, 0.005, "Newton, converged in the mesh"),
    Forced(
        tuple(sign * q for q in (0.001, 0.004, 0.006, 0.008, 0.01) for sign in (1, -1)),
        ((0.003, 2.5, 1), (0.003, 3.6, 4)),
        tolerance=0.02,
        floor=1e-4,
        duration=16.0,
        settle=6.0,
    ),
)
