"""The flows of a case as a simulation: one column of a batch per episode."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cloudpickle
import numpy as np
from gymnasium.spaces import Box

from manywake.case import describe
from manywake.case.task import Task
from manywake.env.control import ControlledFlows, drive, spaces
from manywake.flow import archive, baseline, store
from manywake.flow.baseline import Progress
from manywake.flow.store import Flow
from manywake.learn import evaluate
from manywake.learn import policy as policies
from manywake.learn.engine import Engine
from manywake.learn.evaluate import Evaluation
from manywake.learn.policy import Policy
from manywake.learn.rollout import Context, Episode
from manywake.suite.load import Chosen

KIND = "flow"


@dataclass(frozen=True)
class Flows:
    """A flow under the task that was chosen for it."""

    flow: Flow
    chosen: Chosen

    def __reduce__(self):
        # what a user's file defines travels as what it is, not by the name of a module that is not everywhere
        return _unpacked, (cloudpickle.dumps((self.flow, self.chosen)),)

    @property
    def task(self) -> Task:
        return self.chosen.task

    @property
    def horizon(self) -> int:
        return self.task.actions

    def spaces(self) -> tuple[Box, Box]:
        return spaces(self.flow.case, self.task)

    def variant(self, seed: int) -> int:
        return 0

    def play(self, driving: Sequence[Policy], contexts: list[Context]) -> list[Episode]:
        count, policy_seconds, begin = len(contexts), 0.0, time.perf_counter()
        flows = ControlledFlows(self.flow, self.task, count)
        noise = np.stack([context.noise for context in contexts], axis=1)
        which = np.stack([context.which for context in contexts], axis=1)
        log_probs: list[np.ndarray] = []

        def choose(t: int, seen: np.ndarray) -> np.ndarray:
            nonlocal policy_seconds
            start = time.perf_counter()
            actions, log_prob = policies.draw(driving, which[t], seen, noise[t])
            log_probs.append(log_prob)
            policy_seconds += time.perf_counter() - start
            return actions

        steps, diverged, length = [], np.zeros(count, dtype=bool), np.full(count, self.horizon)
        for t, step in enumerate(drive(flows, choose, self.horizon)):
            steps.append(step)
            length[step.outcome.diverged & ~diverged] = t + 1
            diverged |= step.outcome.diverged
            if diverged.all():
                break
        flow_seconds = time.perf_counter() - begin - policy_seconds
        outcomes = [step.outcome for step in steps]
        readings = {name: np.stack([outcome.means[name] for outcome in outcomes]) for name in flows.free}
        share = np.stack([outcome.amplitude for outcome in outcomes]) / flows.limits[:, None]
        readings["amplitude_rms"] = np.sqrt(np.mean(share**2, axis=1))
        series = [
            np.array([policy.version for policy in driving])[which],
            np.stack([step.observation for step in steps]),
            np.stack([step.action for step in steps]),
            np.stack(log_probs),
            np.stack([outcome.reward for outcome in outcomes]),
        ]

        def one(b: int, index: int) -> Episode:
            n = length[b]
            version, seen, action, log_prob, reward = (part[:n, b].copy() for part in series)
            mine = {name: part[:n, b].copy() for name, part in readings.items()}
            last, seconds = steps[n - 1].after[b].copy(), (flow_seconds / count, policy_seconds / count)
            return Episode(index, version, seen, last, action, log_prob, reward, mine, bool(diverged[b]), *seconds)

        return [one(b, context.index) for b, context in enumerate(contexts)]

    def summary(self, episode: Episode) -> dict[str, float]:
        """Return means of all readings in total, over the episode and its second half, and the amplitudes' rms.

        The last is over all inputs, in units of their limits.
        """
        numbers, half = {}, len(episode.rewards) // 2
        for name, series in episode.readings.items():
            if "." not in name and name != "amplitude_rms":
                numbers[name] = float(series.mean())
                numbers[f"{name}_second_half"] = float(series[half:].mean())
        return numbers | {"amplitude_rms": math.sqrt(float(np.mean(episode.readings["amplitude_rms"] ** 2)))}

    def gain(self, summary: dict[str, float]) -> float:
        free = self.flow.baseline.free.get("c_d", math.nan)
        return 1.0 - summary.get("c_d_second_half", math.nan) / free

    def expected_seconds(self, lanes: int) -> float | None:
        flows = ControlledFlows(self.flow, self.task, lanes)
        still = np.zeros((lanes, flows.mixing.shape[1]))
        flows.act(still)  # compiles, or loads what was compiled
        start = time.perf_counter()
        flows.act(still)
        flows.observe()
        return self.horizon * (time.perf_counter() - start)

    def evaluate(self, policy: Policy, engine: Engine) -> Evaluation:
        return evaluate.evaluate(engine.share(self), self.flow, self.task, policy, engine)

    def describe(self) -> dict[str, Any]:
        chosen, definition = self.chosen, self.chosen.definition
        user = None if definition.shipped or definition.file is None else str(definition.file)
        settings = _settings(chosen)
        return {
            "kind": KIND,
            "name": definition.name,
            "shipped": definition.shipped,
            "file": user,
            "file_sha256": None if definition.shipped else definition.sha256,
            "protocol": chosen.protocol,
            # those that were given as objects are in the settings, but open nothing
            "overrides": {name: value for name, value in chosen.overrides.items() if _plain(value)},
            "digest": describe.digest(settings),
            **settings,
        }

    def save(self, folder: Path) -> dict[str, Any]:
        baseline.save(self.flow.baseline, folder / "baseline.npz")
        archive.save(self.flow.operators, folder / "operators.npz")
        definition = self.chosen.definition
        if definition.file is not None and not definition.shipped:
            (folder / "case.py").write_bytes(definition.file.read_bytes())  # to be read; nothing here runs it
        return {"baseline": self.flow.baseline.digest(), "operators": self.flow.operators.digest}


def _unpacked(code: bytes) -> Flows:
    return Flows(*cloudpickle.loads(code))


def _settings(chosen: Chosen) -> dict[str, Any]:
    return {"case": describe.case(chosen.case), "task": describe.task(chosen.case, chosen.task)}


def _plain(value: Any) -> bool:
    return all(map(_plain, value)) if isinstance(value, tuple | list) else isinstance(value, str | int | float | None)


def open_flows(chosen: Chosen, progress: Progress | None = None) -> Flows:
    """Return the flows of a case, from a baseline that is shipped, cached or made now."""
    return Flows(store.flow(chosen.case, progress), chosen)


def reopen(folder: Path, described: dict[str, Any], chosen: Chosen) -> Flows:
    """Return what a run played, from the operators and the baseline it keeps; ValueError when `chosen` is another case.

    described: what `Flows.describe` wrote. Nothing of the folder is run.
    """
    definition = chosen.definition
    if described["file_sha256"] != (None if definition.shipped else definition.sha256):
        raise ValueError(
            f"case: {definition.file or definition.name} is not the file that {folder} was made with (whose sha256 "
            f"begins with {str(described['file_sha256'])[:12]}); a copy of that one, to read, is {folder / 'case.py'}"
        )
    settings = _settings(chosen)
    if describe.digest(settings) != described["digest"]:
        changed = [part for part, value in settings.items() if value != described[part]]
        raise ValueError(
            f"case: the {' and the '.join(changed) or 'settings'} of {definition.name!r} are not those that {folder} "
            "was made with; wanted the version of manywake, or the settings, that made it"
        )
    base = baseline.load(folder / "baseline.npz", chosen.case)
    ops = archive.load(folder / "operators.npz", base.mesh)
    return Flows(Flow(chosen.case, ops, base), chosen)
