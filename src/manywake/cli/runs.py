"""manywake evaluate, manywake replay: what a run's policy does."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from manywake import api
from manywake.cli import show
from manywake.cli.show import Json, console

RunFolder = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
File = Annotated[
    Path | None,
    tyro.conf.arg(help="The case file of the run, if it was a user's own; its hash is compared."),
]
Env = Annotated[str | None, tyro.conf.arg(help="The simulation that the run was made with, if it was made with --env.")]


@dataclass(frozen=True)
class Evaluate:
    """Play a run's deterministic policy, for a flow against the uncontrolled one."""

    run_folder: RunFolder
    case: File = None
    env: Env = None
    checkpoint: Literal["last", "best"] = "last"
    """Which policy: the last, or the one whose episodes had the best mean reward."""
    workers: int = 2
    """Threads that play."""
    json: Json = False

    def run(self) -> int:
        """Print the table and draw the pictures."""
        numbers = evaluated(api.load_run(self.run_folder, self.case, env=self.env), self.checkpoint, self.workers)
        if self.json:
            print(json.dumps(numbers))
        return 0


def evaluated(opened: api.OpenRun, checkpoint: str, workers: int) -> dict[str, Any]:
    """Evaluate a run's policy, show and keep what came out, draw it; return the numbers."""
    from manywake.learn import runs

    with console.status("evaluating the deterministic policy"):
        found = api.evaluate(opened, checkpoint, workers)
    tail = "" if checkpoint == "last" else f"-{checkpoint}"
    numbers = found.summary()
    runs.write_json(opened.folder / f"evaluation{tail}.json", numbers)
    found.draw(opened.folder, tail)
    show.table(found.table())
    return numbers


@dataclass(frozen=True)
class Replay:
    """Play one episode of a run again, alone, with the policies it was played by, and compare it with its record."""

    run_folder: RunFolder
    episode: Annotated[int, tyro.conf.Positional]
    """Its number, from 0."""
    case: File = None
    env: Env = None
    json: Json = False

    def run(self) -> int:
        """Print its numbers; 1 when they are not those of the record."""
        from manywake.learn.replay import replay

        opened = api.load_run(self.run_folder, self.case, env=self.env)
        result = replay(opened.run, opened.simulation, self.episode)
        described = {
            "episode": self.episode,
            "versions": sorted(set(result.episode.versions.tolist())),
            **result.numbers,
            "same_as_recorded": result.same,
        }
        show.numbers(described, self.json)
        return 1 if result.same is False else 0
