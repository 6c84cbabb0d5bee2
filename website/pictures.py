"""The pictures and films of the flows' pages: `python -m website.pictures [NAME ...]`, all where none is named.

A flow with a policy that ships gets a film, `docs/flows/NAME.mp4`, at most 50 L/U long; every flow a picture.
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image

from manywake import api, movie
from manywake.env.scene import Scene
from manywake.flow import store
from manywake.learn import flows
from manywake.suite import load

FOLDER = Path(__file__).parents[1] / "docs" / "flows"
LONGEST = 50.0
"""Of a film, in L/U."""


def film(name: str) -> None:
    """Film the policy that ships with a flow, of several Reynolds numbers at the last."""
    simulation = flows.open_flows(load.choose(name))
    task, flow = simulation.task, simulation.flows[-1]
    actions = min(task.actions, round(LONGEST * flow.case.convective_time / task.interval))
    movie.movie(flow, task, api.controller_of(simulation, "pretrained"), FOLDER / f"{name}.mp4", actions)


def picture(name: str) -> None:
    """Draw the start state of a flow, without traces."""
    flow = store.flow(load.load(name).case)
    drawn = Scene(flow, 1.0).field(flow.baseline.start, np.zeros(len(flow.case.actuators)))
    Image.fromarray(drawn).quantize(128).save(FOLDER / f"{name}.png", optimize=True)


def main() -> None:
    """Make the pictures of the flows that are named, or of all."""
    FOLDER.mkdir(exist_ok=True)
    for name in sys.argv[1:] or load.names():
        picture(name)
        if load.load(name).policy is not None:
            film(name)
        print(name, *(f"{path.name} {path.stat().st_size / 1e3:.0f} kB" for path in sorted(FOLDER.glob(f"{name}.*"))))


if __name__ == "__main__":
    main()
