"""Learning against the time between actions, T_a (the paper's appendix C, figure 8).

Claim: with T_a of 0.45 % of a shedding period T_K exploration moves nothing, with 100 % an action cannot follow the
phase; in between, at 10 %, the policy learns. Three runs each, episodes of equal physical length (six periods).
Here: T_a = 3, 66, 661 steps of 5e-4, that is 1322, 60 and 6 actions an episode; 240 episodes. A minibatch is always a
fifth of the batch, and the discount of an action is 0.99 whatever T_a is, as the paper says nothing else.
Command: manywake figure action-period
Cost: 9 trainings, 20 min (an update with 1322 actions takes 35 s of a core, with 60 or 6 14 s).
Expected: at 10 % C_D falls as in `synced`; at 0.45 % it stays near the uncontrolled 3.21, and at 100 % where the noise
alone has it, which is 3.15 when it is held for a whole period.
"""

from experiments import learning_curves, trainings
from experiments.experiment import Setup
from experiments.trainings import CASE, Training

EPISODES = 240
ACTIONS = {3: 1322, 66: 60, 661: 6}
"""Steps of an action -> actions of an episode: 3966, 3960 and 3966 steps."""
SHARES = {3: "0.45 %", 66: "10 %", 661: "100 %"}
BY_PROTOCOL = True


def wanted(setup: Setup) -> dict[str, list[Training]]:
    changes = {
        f"{steps} steps": {"interval": round(steps * CASE.dt, 10), "actions": actions}
        for steps, actions in ACTIONS.items()
    }
    return trainings.seeded(setup, "action-period", EPISODES, changes)


def run(setup: Setup) -> None:
    sets = trainings.trained(setup, wanted(setup))
    learning_curves.write_tables(setup, "action-period", sets)


def plot(setup: Setup) -> None:
    labels = {f"{steps} steps": f"$T_a$ = {steps} dt, {share} of $T_K$" for steps, share in SHARES.items()}
    title = "Learning against the time between actions: runs thin, means thick"
    learning_curves.plot_against_episodes(setup, "action-period", labels, title)


def summary(setup: Setup) -> dict:
    return learning_curves.summary(setup, "action-period")
