"""What a page has to know of a flow before its frames say anything."""

from typing import Any

import numpy as np

from manywake.play.pair import Pair
from manywake.play.picture import Picture


def described(pair: Pair, picture: Picture) -> dict[str, Any]:
    """Return what is shown of a pair, and what its picture draws, as JSON can hold it."""
    base, case = pair.flow.baseline, pair.flow.case
    return {
        "name": pair.simulation.chosen.definition.name,
        "reynolds": case.reynolds,
        "shown": [{"name": n, "free": base.free[n], "steady": _number(base.steady.get(n))} for n in pair.shown],
        "actions": _labels(pair),
        "window": round(pair.window, 2),
        **picture.described(),
    }


def _number(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else float(value)


def _labels(pair: Pair) -> list[str]:
    """Return what each action drives, by the actuators' names: with a plus where it drives forwards."""
    names = [actuator.on for actuator in pair.flow.case.actuators]
    return [
        ", ".join(f"{name} {'+' if weight > 0 else '−'}" for name, weight in zip(names, column, strict=True) if weight)
        for column in pair.mixing.T
    ]
