"""The flows of a case as a simulation: one column of a batch per episode."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypedDict

import cloudpickle
import numpy as np
from gymnasium.spaces import Box

from manywake.case import describe
from manywake.case import task as tasks
from manywake.case.task import Task
from manywake.env.control import ControlledFlows, drive, spaces
from manywake.flow import archive, baseline, store
from manywake.flow.baseline import Progress
from manywake.flow.store import Flow
from manywake.learn import evaluate
from manywake.learn import policy as policies
from manywake.learn.controllers import Controller, Learnt
from manywake.learn.engine import Engine
from manywake.learn.evaluate import Evaluation, Evaluations
from manywake.learn.policy import Policy
from manywake.learn.rollout import Context, Episode, Simulation
from manywake.suite.load import Chosen

KIND = "flow"


class Described(TypedDict):
    """What `Flows.describe` says."""

    kind: str
    name: str
    shipped: bool
    file: str | None
    file_sha256: str | None
    protocol: str
    overrides: dict[str, Any]
    digest: str
    case: dict[str, Any]
    task: dict[str, Any]


@dataclass(frozen=True)
class Flows(Simulation):
    """Flows under the task that was chosen for them: one, or one for each Reynolds number that episodes may have."""

    flows: tuple[Flow, ...]
    chosen: Chosen

    def __reduce__(self):
        # what a user's file defines travels as what it is, not by the name of a module
        return _unpacked, (cloudpickle.dumps((self.flows, self.chosen)),)

    @property
    def task(self) -> Task:
        return self.chosen.task

    @property
    def horizon(self) -> int:  # type: ignore[override]
        return self.task.actions

    def spaces(self) -> tuple[Box, Box]:
        return spaces(self.chosen.case, self.task)

    def variant(self, seed: int) -> int:
        return tasks.drawn(self.task, seed)

    def play(self, driving: Sequence[Policy], contexts: list[Context]) -> list[Episode]:
        count, policy_seconds, begin = len(contexts), 0.0, time.perf_counter()
        flow = self.flows[self.variant(contexts[0].seed)]
        flows = ControlledFlows(flow, self.task, count)
        flows.reset(range(count), [context.seed for context in contexts])
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
        seconds = (time.perf_counter() - begin - policy_seconds) / count, policy_seconds / count
        outcomes = [step.outcome for step in steps]
        readings = {name: np.stack([outcome.means[name] for outcome in outcomes]) for name in flows.free}
        share = np.stack([outcome.amplitudes[-1] for outcome in outcomes]) / flows.limits[:, None]
        readings["amplitude_rms"] = np.sqrt(np.mean(share**2, axis=1))
        if self.task.reynolds_numbers:
            readings["reynolds"] = np.full(share.shape[::2], flow.case.reynolds)
        versions = np.array([policy.version for policy in driving])[which]
        observations, actions = (np.stack([getattr(s, name) for s in steps]) for name in ("observation", "action"))
        series = versions, observations, actions, np.stack(log_probs), np.stack([o.reward for o in outcomes])

        def one(b: int, n: int) -> Episode:
            version, seen, action, log_prob, reward = (part[:n, b].copy() for part in series)
            mine, last = {name: part[:n, b].copy() for name, part in readings.items()}, steps[n - 1].after[b].copy()
            own = contexts[b].index, version, seen, last, action, log_prob, reward
            return Episode(*own, mine, bool(diverged[b]), *seconds)

        return [one(b, n) for b, n in enumerate(length)]

    def summary(self, episode: Episode) -> dict[str, float]:
        """Return means of readings in total, over the whole and the second half, and the rms of amplitude / limit."""
        numbers, half = {}, len(episode.rewards) // 2
        if self.task.reynolds_numbers:
            numbers["reynolds"] = float(episode.readings["reynolds"][0])
        for name, series in episode.readings.items():
            if "." not in name and name not in ("amplitude_rms", "reynolds"):
                numbers[name] = float(series.mean())
                numbers[f"{name}_second_half"] = float(series[half:].mean())
        return numbers | {"amplitude_rms": math.sqrt(float(np.mean(episode.readings["amplitude_rms"] ** 2)))}

    def gain(self, summary: dict[str, float]) -> float:
        numbers = self.task.reynolds_numbers
        flow = self.flows[numbers.index(summary["reynolds"]) if numbers else 0]
        return 1.0 - summary.get("c_d_second_half", math.nan) / flow.baseline.free.get("c_d", math.nan)

    def expected_seconds(self, lanes: int) -> float | None:
        return max(self._seconds(flow, lanes) for flow in self.flows)

    def _seconds(self, flow: Flow, lanes: int) -> float:
        """Return about how long a block of episodes of one flow takes."""
        flows = ControlledFlows(flow, self.task, lanes)
        still = np.zeros((lanes, flows.mixing.shape[1]))
        flows.act(still)  # compiles, or loads what was compiled
        start = time.perf_counter()
        flows.act(still)
        flows.observe()
        return self.horizon * (time.perf_counter() - start)

    def evaluate(self, policy: Policy, engine: Engine) -> Evaluation | Evaluations:
        return self.judge(Learnt(policy), engine)

    def judge(self, controller: Controller, engine: Engine) -> Evaluation | Evaluations:
        """Return what a controller achieves."""
        shared = engine.share(self)
        found = [evaluate.evaluate(shared, k, flow, self.task, controller, engine) for k, flow in enumerate(self.flows)]
        return Evaluations(found) if self.task.reynolds_numbers else found[0]

    def describe(self) -> dict[str, Any]:
        chosen, definition = self.chosen, self.chosen.definition
        own, said = not definition.shipped and definition.file is not None, settings(chosen)
        return {
            "kind": KIND,
            "name": definition.name,
            "shipped": definition.shipped,
            "file": str(definition.file) if own else None,
            "file_sha256": definition.sha256 if own else None,
            "protocol": chosen.protocol,
            # those that were given as objects are in the settings, but open nothing
            "overrides": {name: value for name, value in chosen.overrides.items() if _plain(value)},
            "digest": describe.digest(said),
            **said,
        }

    def save(self, folder: Path) -> dict[str, Any]:
        kept: dict[str, list[str]] = {"baseline": [], "operators": []}
        for tail, flow in zip(_tails(self.chosen), self.flows, strict=True):
            baseline.save(flow.baseline, folder / f"baseline{tail}.npz")
            archive.save(flow.operators, folder / f"operators{tail}.npz")
            kept["baseline"].append(flow.baseline.digest())
            kept["operators"].append(flow.operators.digest)
        definition = self.chosen.definition
        if definition.file is not None and not definition.shipped:
            (folder / "case.py").write_bytes(definition.content)  # to be read; nothing here runs it
        if (mesh := self.chosen.case.mesh) is not None and Path(mesh.path).is_file():
            (folder / Path(mesh.path).name).write_bytes(Path(mesh.path).read_bytes())  # where that copy looks for it
        return kept


def _tails(chosen: Chosen) -> list[str]:
    """Return what tells the files of a run's flows apart."""
    return [f"-{re:g}" for re in chosen.task.reynolds_numbers] or [""]


def _unpacked(code: bytes) -> Flows:
    return Flows(*cloudpickle.loads(code))


def settings(chosen: Chosen) -> dict[str, Any]:
    """Return what was chosen to be played, as JSON can hold it; its digest tells it from all else."""
    return {"case": describe.case(chosen.case), "task": describe.task(chosen.case, chosen.task)}


def _plain(value: Any) -> bool:
    return all(map(_plain, value)) if isinstance(value, tuple | list) else isinstance(value, str | int | float | None)


def open_flows(chosen: Chosen, progress: Progress | None = None) -> Flows:
    """Return the flows of a case, from a baseline that is shipped, cached or made now."""
    return Flows(tuple(store.flow(case, progress) for case in chosen.cases), chosen)


def reopen(folder: Path, described: Described, kept: dict[str, list[str]], chosen: Chosen) -> Flows:
    """Return what a run played, as `Flows.describe` wrote it, from the operators and the baseline it keeps.

    Nothing of the folder is run. kept: the hashes of those, as `Flows.save` gave them. ValueError when `chosen`, or
    what is there, is not what was played.
    """
    definition = chosen.definition
    if described["file_sha256"] != (None if definition.shipped else definition.sha256):
        raise ValueError(
            f"case: {definition.file or definition.name} is not the file that {folder} was made with (whose sha256 "
            f"begins with {str(described['file_sha256'])[:12]}); a copy of that one, to read, is {folder / 'case.py'}"
        )
    said = settings(chosen)
    if describe.digest(said) != described["digest"]:
        recorded = {"case": described["case"], "task": described["task"]}
        changed = " and the ".join(part for part, value in said.items() if value != recorded[part]) or "settings"
        got = f"the {changed} of {definition.name!r} are not those that {folder} was made with"
        raise ValueError(f"case: {got}; wanted the version of manywake, or the settings, that made it")
    found = []
    for tail, case in zip(_tails(chosen), chosen.cases, strict=True):
        base = baseline.load(folder / f"baseline{tail}.npz", case)
        found.append(Flow(case, archive.load(folder / f"operators{tail}.npz", base.mesh), base))
    there = {"baseline": [f.baseline.digest() for f in found], "operators": [f.operators.digest for f in found]}
    for name, digests in there.items():
        if kept.get(name) != digests:
            raise ValueError(f"run: the {name} in {folder} is not that which settings.json has the hash of")
    return Flows(tuple(found), chosen)
