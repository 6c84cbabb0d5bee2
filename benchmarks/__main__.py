"""python -m benchmarks NAME, or manywake bench NAME."""

from dataclasses import dataclass
from typing import Annotated, Literal

import tyro

from benchmarks import cost, draw, peers, roofline, scaling, step
from manywake.cli import show
from manywake.cli.show import Json


@dataclass(frozen=True)
class Bench:
    """Measure, and print what was measured.

    step: milliseconds per flow and time step, forces, probes and control law included. draw: pictures a second.
    roofline: each kernel beside what this core's arithmetic and memory allow. cost: time and memory of a flow against
    the number of triangles. scaling: speed-up of collection with the number of environments (half an hour, mostly
    asleep). peers: the paper's scheme in FEniCS, as written and tuned, and in scikit-fem, beside ours (what is
    installed; ten minutes).
    """

    what: Annotated[Literal["step", "draw", "roofline", "cost", "scaling", "peers"], tyro.conf.Positional]
    lanes: tuple[int, ...] = (1, 8, 16, 32)
    """Batch widths that step measures."""
    json: Json = False

    def run(self) -> int:
        """Print the numbers."""
        others = {"draw": draw, "roofline": roofline, "cost": cost, "scaling": scaling, "peers": peers}
        found = step.measure(self.lanes) if self.what == "step" else others[self.what].measure()
        show.numbers(found, self.json)
        return 0


def main() -> None:
    """Run the command."""
    show.ending(lambda: tyro.cli(Bench, prog="manywake bench").run())


if __name__ == "__main__":
    main()
