"""Defects on purpose: each changes a line of solver, task, collector or learner, and some fast test must notice it.

A copy of the package gets the defect, and the test files that ought to notice run on it until the first that fails.
`python -m tests.slow.test_mutations` prints which test noticed which.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Defect:
    """In a file below src/manywake `right`, which is there once, becomes `wrong`.

    tests: names of the files that ought to notice.
    """

    what: str
    file: str
    right: str
    wrong: str
    tests: str


DEFECTS = (
    # ---- solver
    Defect(
        "convection with a wrong sign along one direction",
        "flow/kernels.py",
        "mul(-weight * inverse[t, q, 0], u)",
        "mul(weight * inverse[t, q, 0], u)",
        "kernels",
    ),
    Defect(
        "twice the traction at an outlet",
        "flow/kernels.py",
        "mul(-0.5, maximum(0.0, inwards))",
        "mul(-1.0, maximum(0.0, inwards))",
        "kernels",
    ),
    Defect(
        "a force made with the old pressure",
        "flow/stepper.py",
        "f = fma(p_value[k], sub(load(p, i, 0), double(load(p_star, i, 0))), f)",
        "f = fma(0.0 * p_value[k], sub(load(p, i, 0), double(load(p_star, i, 0))), f)",
        "flow validate",
    ),
    Defect(
        "a viscosity one per cent off in what is explicit",
        "flow/operators.py",
        "factors.pair(-nu * K, -old / dt * M)",
        "factors.pair(-1.01 * nu * K, -old / dt * M)",
        "flow validate",
    ),
    Defect(
        "jets that suck where they should blow",
        "flow/problem.py",
        "profiles[i] /= share",
        "profiles[i] /= -share",
        "flow",
    ),
    Defect(
        "a torque of the other sense",
        "flow/problem.py",
        "phi[2, nodes] = np.stack([-y, x], axis=1)",
        "phi[2, nodes] = np.stack([y, -x], axis=1)",
        "readings",
    ),
    Defect(
        "power that is taken out is credited",
        "flow/readings.py",
        'power = power + np.maximum(q * parts[f"work.{name}"] + blown, 0.0)',
        'power = power + (q * parts[f"work.{name}"] + blown)',
        "readings",
    ),
    Defect(
        "a pressure extrapolated to first order only",
        "case/schemes.py",
        '"bdf2-mean", 1.5, (2.0, -0.5), 1.0, (4 / 3, -1 / 3)',
        '"bdf2-mean", 1.5, (2.0, -0.5), 1.0, (1.0, 0.0)',
        "flow validate",
    ),
    Defect(
        "noise of a sensor with a third of its variance",
        "env/errors.py",
        "_SUMMED = 12",
        "_SUMMED = 4",
        "task",
    ),
    Defect(
        "a confidence interval of one side",
        "flow/statistics.py",
        "stdtrit(len(values) - 1, 0.975)",
        "stdtrit(len(values) - 1, 0.95)",
        "baseline",
    ),
    # ---- task
    Defect(
        "a delay that is one action short",
        "env/control.py",
        "clipped, self._pending = queue[0], queue[1:]",
        "clipped, self._pending = queue[-1], queue[1:]",
        "task",
    ),
    Defect(
        "a history with the newest first",
        "env/control.py",
        "self._frames = np.concatenate([self._frames[:, 1:], newest], axis=1)",
        "self._frames = np.concatenate([newest, self._frames[:, :-1]], axis=1)",
        "task",
    ),
    Defect(
        "a blow-up that is charged once, not for every action left",
        "env/control.py",
        "return left * self.charge",
        "return self.charge",
        "env",
    ),
    Defect(
        "an exponential law with its share at any step",
        "case/laws.py",
        "alpha = round(1.0 - (1.0 - self.alpha) ** ratio, 12)",
        "alpha = self.alpha",
        "env",
    ),
    Defect(
        "a ramp that is a step late",
        "case/laws.py",
        "share = (np.arange(steps) + 1.0)[:, None, None] / steps",
        "share = np.arange(steps)[:, None, None] / steps",
        "env",
    ),
    # ---- collector
    Defect(
        "an off-by-one in the episode's seed",
        "learn/rollout.py",
        "return int(np.random.SeedSequence(run_seed, spawn_key=(index,)).generate_state(1)[0])",
        "return int(np.random.SeedSequence(run_seed, spawn_key=(index + 1,)).generate_state(1)[0])",
        "rollout collect runs",
    ),
    Defect(
        "a plan whose episodes get a policy that is not made yet",
        "learn/schedule.py",
        'np.searchsorted(ready, asked, side="right")',
        'np.searchsorted(ready, asked, side="right") + 1',
        "schedule",
    ),
    Defect(
        "an update of the first episodes to come, whichever they are",
        "learn/schedule.py",
        "time[k], update[k] = now, arrived // period",
        "time[k], update[k] = now, k // period",
        "schedule",
    ),
    Defect(
        "actions drawn with the variance in place of the deviation",
        "learn/policy.py",
        "action = (mean + policy.std * noise).astype(np.float32)",
        "action = (mean + policy.std**2 * noise).astype(np.float32)",
        "policy",
    ),
    # ---- learner
    Defect(
        "an unbootstrapped horizon",
        "learn/ppo.py",
        "rewards[-1][-1] += self.gamma * end_value",
        "rewards[-1][-1] += 0.0 * end_value",
        "ppo",
    ),
    Defect(
        "a stale normaliser",
        "learn/ppo.py",
        "normaliser(self).update(observations)",
        "normaliser(self)",
        "ppo",
    ),
    Defect(
        "a ratio that is always to the current policy",
        "learn/ppo.py",
        'if self.learning.ratio_to == "current":',
        'if self.learning.ratio_to != "":',
        "ppo",
    ),
    Defect(
        "episodes that run into one another",
        "learn/ppo.py",
        "starts.append(np.arange(len(episode.rewards)) == 0)",
        "starts.append(np.arange(len(episode.rewards)) < 0)",
        "ppo",
    ),
    Defect(
        "a learning rate that falls an update early",
        "learn/ppo.py",
        "min(progress_remaining + self.share, 1.0)",
        "min(progress_remaining, 1.0)",
        "ppo",
    ),
)


def noticed(defect: Defect, folder: Path) -> str | None:
    """Return the first test that fails on a copy of the package with a defect; None where all pass."""
    shutil.copytree(CHECKOUT / "src", folder / "src")
    path = folder / "src" / "manywake" / defect.file
    text = path.read_text()
    assert text.count(defect.right) == 1, f"{defect.file} has {text.count(defect.right)} times: {defect.right}"
    path.write_text(text.replace(defect.right, defect.wrong))
    return first_failure(folder, defect.tests)


def first_failure(folder: Path, tests: str) -> str | None:
    """Return the first of some tests that fails on the package in a folder; None where all pass."""
    files = [str(CHECKOUT / "tests" / f"test_{name}.py") for name in tests.split()]
    words = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *files]
    where = os.environ | {"PYTHONPATH": str(folder / "src"), "NUMBA_CACHE_DIR": str(folder / "kernels")}
    done = subprocess.run(words, cwd=CHECKOUT, env=where, capture_output=True, text=True)
    assert done.returncode in (0, 1), done.stdout[-2000:] + done.stderr[-2000:]
    failed = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return failed[0].split(" ")[1] if done.returncode else None


def test_a_copy_without_a_defect_passes(tmp_path):
    shutil.copytree(CHECKOUT / "src", tmp_path / "src")
    every = sorted({name for defect in DEFECTS for name in defect.tests.split()})
    assert first_failure(tmp_path, " ".join(every)) is None


@pytest.mark.parametrize("defect", DEFECTS, ids=lambda defect: defect.what)
def test_a_defect_is_noticed(defect, tmp_path):
    assert noticed(defect, tmp_path) is not None


if __name__ == "__main__":
    for each in DEFECTS:
        with tempfile.TemporaryDirectory() as made:
            print(f"{each.what}: {noticed(each, Path(made)) or 'NOBODY'}", flush=True)
