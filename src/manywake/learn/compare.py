"""Runs side by side: groups that differ in the seed alone, their means with 95 % intervals, Welch's test."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from string import ascii_uppercase
from typing import Any

import numpy as np

from manywake.flow.statistics import half_width
from manywake.learn import tables
from manywake.learn.runs import Run

DECIDING = ("schedule", "clock", "newest_policy", "episode_seconds", "episode_spread", "update_seconds")
"""What of the collection decides a result; where it runs does not, or only unsynced on the machine's clock."""
MEASURES = {"saved": "drag saved", "reward": "reward of an action"}


@dataclass(frozen=True)
class Result:
    """A run as far as it has come.

    saved, reward: of the long run without noise, mean over its starts (and Reynolds numbers); the reward is that of an
    action, of another simulation the sum over an episode. None where that is not known. evaluated: it has
    evaluation.json. blew_up: a flow of it did. drags: C_D of the uncontrolled and of the steady flow.
    """

    folder: Path
    case: str
    seed: int
    episodes: int
    of: int
    minutes: float
    evaluated: bool
    blew_up: bool
    saved: float | None
    reward: float | None
    drags: tuple[float, float] | None
    table: dict[str, np.ndarray]

    def plain(self) -> dict[str, Any]:
        shown = ("case", "seed", "episodes", "of", "minutes", "evaluated", "blew_up", "saved", "reward")
        return {"run": str(self.folder)} | {name: getattr(self, name) for name in shown}


@dataclass(frozen=True)
class Group:
    """Runs that train the same. said: what their settings say in words. what: all that decides their results."""

    letter: str
    name: str
    what: dict[str, Any]
    said: dict[str, Any]
    results: list[Result]

    def numbers(self, measure: str) -> list[float]:
        """Return what is known of a measure, a number a run."""
        return [value for result in self.results if (value := getattr(result, measure)) is not None]

    def interval(self, measure: str) -> tuple[float, float | None] | None:
        """Return the mean over the seeds and half the width of its 95 % interval; None of one seed, or of none."""
        values = np.array(self.numbers(measure))
        if len(values) < 2:
            return (float(values[0]), None) if len(values) else None
        return float(values.mean()), half_width(values)

    def plain(self) -> dict[str, Any]:
        seeds = [result.seed for result in self.results]
        return {"group": self.letter, "name": self.name, "seeds": seeds} | {
            name: dict(zip(("mean", "error"), self.interval(name) or (None, None), strict=True)) for name in MEASURES
        }


@dataclass(frozen=True)
class Difference:
    """Second group less the first. low, high: of the 95 % interval. p: of Welch's test, two-sided; None: no spread."""

    measure: str
    first: str
    second: str
    difference: float
    low: float
    high: float
    p: float | None


@dataclass(frozen=True)
class Comparison:
    """Groups of runs, and how all others differ from the first."""

    groups: list[Group]
    differences: list[Difference]

    def summary(self) -> dict[str, Any]:
        runs = [{"group": g.letter, **result.plain()} for g in self.groups for result in g.results]
        groups = [group.plain() for group in self.groups]
        return {"runs": runs, "groups": groups, "differences": [asdict(part) for part in self.differences]}

    def draw(self, path: Path) -> None:
        """Draw the learning curves: drag, or the reward unless every run has a drag."""
        from manywake import plots

        results = [result for group in self.groups for result in group.results if result.table]
        drag = all("c_d_second_half" in result.table for result in results)
        name, label = ("c_d_second_half", "$C_D$, 2nd half of episode") if drag else ("reward", "reward of an episode")
        curves = [
            (f"{g.letter}: {g.name}", [plots.update_means(r.table, name) for r in g.results if r.table])
            for g in self.groups
        ]
        known = {result.drags for result in results}
        (common,) = known if len(known) == 1 else (None,)
        lines = {} if common is None or not drag else {"uncontrolled, mean": common[0], "steady flow": common[1]}
        plots.compare(curves, label, lines, path)


def compare(folders: Sequence[Path]) -> Comparison:
    """Read runs and compare them; ValueError when one is no run, or is named twice."""
    if len({folder.resolve() for folder in folders}) < len(folders):
        raise ValueError(f"compare: got a run twice in {' '.join(map(str, folders))}, wanted each once")
    made: list[tuple[dict[str, Any], dict[str, Any], list[Result]]] = []
    for folder in folders:
        run = Run(folder)
        described = run.described()
        what, result = deciding(described), read(run)
        known = next((results for other, _, results in made if other == what), None)
        if known is None:
            made.append((what, _said(described), [result]))
            continue
        again = next((one for one in known if one.seed == result.seed), None)
        if again is not None and (what["schedule"], what["clock"]) != ("unsynced", "real"):
            got = f"{again.folder} and {folder}, which are one training with one seed"
            raise ValueError(f"compare: got {got}; wanted one of them: two count as two seeds")
        known.append(result)
    letters = [ascii_uppercase[k % 26] * (k // 26 + 1) for k in range(len(made))]
    names = _names(made)
    groups = [Group(letter, name, *one) for letter, name, one in zip(letters, names, made, strict=True)]
    return Comparison(groups, [part for other in groups[1:] for part in differences(groups[0], other)])


def deciding(described: dict[str, Any]) -> dict[str, Any]:
    """Return all of settings.json that decides a run's result, but for its seed."""
    simulation, how, layout = (described[name] for name in ("simulation", "collection", "layout"))
    flow = "digest" in simulation
    plays = {
        name: part for name, part in simulation.items() if (name in ("case", "task") if flow else name != "folder")
    }
    decides = {name: how[name] for name in DECIDING}
    if how["schedule"] == "unsynced":
        decides |= layout if how["clock"] == "real" else {"environments": layout["environments"]}
    return {"plays": plays, "learning": described["learning"], **decides}


def _said(described: dict[str, Any]) -> dict[str, Any]:
    """Return the settings of a run that name it among others."""
    simulation, how = described["simulation"], described["collection"]
    said = {"protocol": simulation["protocol"], **simulation["overrides"]} if "protocol" in simulation else {}
    return said | described["learning"] | {name: how[name] for name in DECIDING}


def _names(made: list[tuple[dict[str, Any], dict[str, Any], list[Result]]]) -> list[str]:
    """Return the cases of groups, with the settings in which those of one case differ."""
    names = []
    for what, said, (result, *_) in made:
        rivals = [(other, words) for other, words, (one, *_) in made if one.case == result.case]
        differ: dict[str, Any] = {}
        for mine, all_of_them in ((said, [words for _, words in rivals]), (_flat(what), [_flat(w) for w, _ in rivals])):
            keys = dict.fromkeys(key for words in all_of_them for key in words)
            parted = [key for key in keys if any(words.get(key) != mine.get(key) for words in all_of_them)]
            differ = differ or {key: mine[key] for key in parted if key in mine}
            if parted:
                break
        shown = [f"{key} {_short(value)}" for key, value in differ.items()]
        names.append(", ".join([result.case, *shown[:3], *(["..."] if len(shown) > 3 else [])]))
    return names


def _flat(value: Any, name: str = "") -> dict[str, Any]:
    """Return nested settings by their last names, a number at a time."""
    if not isinstance(value, dict):
        return {name: value}
    return {key: part for k, each in value.items() for key, part in _flat(each, k).items()}


def _short(value: Any) -> str:
    text = f"{value:g}" if isinstance(value, float) else str(value)
    return text if len(text) <= 24 else f"{text[:21]}..."


def read(run: Run) -> Result:
    """Return what a run's files say of it; ValueError where one is damaged."""
    folder, described = run.folder, run.described()
    simulation, updates = described["simulation"], tables.columns(folder / "updates.csv")
    found, ended = _json(folder / "evaluation.json"), _json(folder / "training.json")
    seconds = ended["wall_time_s"] if ended else updates["wall_s"][-1] if updates else 0.0
    parts = list(found["at"].values()) if "at" in found else [found]
    phases = [phase for part in parts for phase in part.get("phases", ())]
    drags = tuple(phases[0].get(name) if phases else None for name in ("cd_uncontrolled", "cd_steady"))
    return Result(
        folder=folder,
        case=simulation.get("name") or simulation.get("env") or simulation["kind"],
        seed=described["seed"],
        episodes=int(updates["episodes"][-1]) if updates else 0,
        of=described["learning"]["episodes"],
        minutes=float(seconds) / 60,
        evaluated=bool(found),
        blew_up=any(phase["diverged"] for phase in phases),
        saved=_mean(phases, "drag_reduction"),
        reward=found.get("reward_mean", _mean(phases, "reward")),
        drags=None if None in drags or len(parts) > 1 else drags,  # type: ignore[arg-type]
        table=tables.columns(folder / "episodes.csv"),
    )


def _mean(phases: list[dict[str, Any]], name: str) -> float | None:
    values = [phase[name] for phase in phases if phase.get(name) is not None]
    return float(np.mean(values)) if values and len(values) == len(phases) else None


def _json(path: Path) -> dict[str, Any]:
    """Return what a file of a run says, nothing where there is none."""
    try:
        data = json.loads(path.read_text()) if path.exists() else {}
    except ValueError as error:
        raise ValueError(f"run: {path} is damaged ({error}); make it again with: manywake evaluate") from None
    if not isinstance(data, dict):
        raise ValueError(f"run: {path} is damaged; make it again with: manywake evaluate")
    return data


def differences(first: Group, second: Group) -> list[Difference]:
    """Return Welch's tests of two groups, of what both have from two seeds on; rewards only where they are the same."""
    same = {"saved": True, "reward": _reward(first) == _reward(second)}
    pairs = {name: (first.numbers(name), second.numbers(name)) for name in MEASURES if same[name]}
    enough = {name: pair for name, pair in pairs.items() if min(map(len, pair)) >= 2}
    return [Difference(name, first.letter, second.letter, *welch(*pair)) for name, pair in enough.items()]


def _reward(group: Group) -> Any:
    """Return what tells a group's reward from another's."""
    plays = group.what["plays"]
    return plays["task"]["reward"] if "task" in plays else plays


def welch(first: Sequence[float], second: Sequence[float]) -> tuple[float, float, float, float | None]:
    """Return the difference of two means, its 95 % interval, and p of Welch's two-sided test; p None without spread."""
    from scipy import stats  # slow to load, and every command loads this module

    a, b = (np.asarray(numbers, dtype=float) for numbers in (first, second))
    difference = float(b.mean() - a.mean())
    if np.ptp(a) == np.ptp(b) == 0:
        return difference, difference, difference, None
    found = stats.ttest_ind(b - a[0], a - a[0], equal_var=False)  # shifted: no spread is none, whatever the mean
    low, high = found.confidence_interval(0.95)
    return difference, float(low), float(high), float(found.pvalue)
