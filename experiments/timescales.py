"""Two time scales: actions now and then, the control at every step (the paper's figure 2).

Claim: with alpha = 0.1 (eq. 2) and 50 steps of an action the control converges to the action well within it.
Here: the first actions of an untrained policy, seed 0, and what eq. 2 makes of them at dt = 5e-4; beside it the linear
ramp of the released code, which arrives at the last step.
Command: manywake figure timescales
Cost: seconds; no flow is needed, as the law knows only actions.
Expected: within 5 % of the change after 29 steps, 0.5 % left after 50 (0.9^50).
"""

import matplotlib.pyplot as plt
import numpy as np

from experiments import learning_curves
from experiments.experiment import Setup, read, rounded, write
from experiments.learning_curves import COLOURS
from experiments.trainings import CASE
from manywake.learn.rollout import context
from manywake.suite.cylinder_jets import PROTOCOLS, RELEASED

ACTIONS = 5
TASK = PROTOCOLS["paper"][0]
STEPS = TASK.steps(CASE.dt)
LAWS = {"exponential": TASK.law, "linear": PROTOCOLS["code"][0].law}


def run(setup: Setup) -> None:
    noise = context(0, 0, ACTIONS, 1).noise[:, 0]
    actions = CASE.actuators[0].limit * np.clip(np.exp(RELEASED.log_std_init) * noise, -1, 1)
    control = {name: np.zeros((1, 1)) for name in LAWS}
    previous, rows = np.zeros((1, 1)), []
    for action in actions.reshape(-1, 1, 1):
        follow = {name: law.series(STEPS, CASE.dt, control[name], previous, action) for name, law in LAWS.items()}
        for s in range(STEPS):
            rows.append({"step": len(rows) + 1, "action": action.item()} | {n: x[s].item() for n, x in follow.items()})
        control, previous = {name: series[-1] for name, series in follow.items()}, action
    write(setup.csv("timescales"), [rounded(row, 8) for row in rows])


def plot(setup: Setup) -> None:
    table = read(setup.csv("timescales"))
    figure, axis = plt.subplots(figsize=(8, 4))
    scale = 1e3
    axis.step(table["step"], scale * table["action"], color="#555555", lw=1, where="mid", label="action a")
    axis.plot(table["step"], scale * table["exponential"], color=COLOURS[0], lw=2, label=r"control c, $\alpha$ = 0.1")
    axis.plot(table["step"], scale * table["linear"], color=COLOURS[3], lw=1.2, ls="--", label="linear ramp")
    axis.legend(fontsize=9, ncols=3, loc="upper center")
    axis.set_ylim(top=1.35 * axis.get_ylim()[1])
    learning_curves.finish(axis, "time step of 5e-4", r"flow rate of the upper jet [$10^{-3}$]")
    learning_curves.save(figure, setup.png("timescales"), "Actions every 50 steps, control at every step")


def summary(setup: Setup) -> dict:
    table = read(setup.csv("timescales"))
    change = abs(table["exponential"] - table["action"])[:STEPS] / abs(table["action"][0])
    return {
        "steps_to_5_per_cent": int(np.argmax(change <= 0.05)) + 1,
        "left_after_the_action": float(change[-1]),
        "action_over_shedding_period": TASK.interval / 0.3307,
    }
