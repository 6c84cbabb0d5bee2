"""Learning against the law by which the control follows the action (the paper's appendix C, figure 9).

Claim: the value of alpha has little to say, all laws learn; the linear ramp is slightly slower, because it reaches the
action later. Three runs each.
Here: eq. 2 with alpha = 0.05, 0.1, 0.2 and the linear ramp of the released code, 300 episodes; the paper's figure
does not say which alphas it shows. alpha = 0.1 is `synced`, whose runs are used. With `--protocol code` the reward is
the released code's, under all four laws.
Command: manywake figure smoothing
Cost: 9 trainings beside those of `synced`, 17 min.
Expected: all four within the seeds' spread; after an action alpha = 0.05 is at 92 %, 0.1 at 99.5 % of it.
"""

from experiments import learning_curves, synced, trainings
from experiments.experiment import Setup
from experiments.trainings import Training

EPISODES = 300
ALPHAS = (0.05, 0.1, 0.2)
BY_PROTOCOL = True


def wanted(setup: Setup) -> dict[str, list[Training]]:
    """Return the trainings; those by the protocol's own law are synced's."""
    laws = {f"alpha {alpha:g}": {"law": "exponential", "law.alpha": alpha} for alpha in ALPHAS}
    laws["linear"] = {"law": "linear"}
    shared = "linear" if setup.protocol == "code" else "alpha 0.1"
    return trainings.seeded(setup, "smoothing", EPISODES, laws) | {shared: synced.group(setup)["20"]}


def run(setup: Setup) -> None:
    learning_curves.write_tables(setup, "smoothing", trainings.trained(setup, wanted(setup)))


def plot(setup: Setup) -> None:
    labels = {f"alpha {alpha:g}": rf"$\alpha$ = {alpha:g}" for alpha in ALPHAS} | {"linear": "linear ramp"}
    title = "Learning against the smoothing of the control: runs thin, means thick"
    learning_curves.plot_against_episodes(setup, "smoothing", labels, title)


def summary(setup: Setup) -> dict:
    return learning_curves.summary(setup, "smoothing")
