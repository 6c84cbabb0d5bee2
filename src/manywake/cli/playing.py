"""manywake play: a page in the browser on which a flow runs live."""

import html
import os
import tempfile
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated

import tyro

from manywake import api
from manywake.cli.runs import of_flow
from manywake.cli.show import say
from manywake.suite import load


@dataclass(frozen=True)
class Play:
    """Open a page in the browser on which a flow runs live, driven by hand or by a controller.

    The same flow without control runs beside it. With a run its newest policy drives, and its learning curve is shown
    as it grows. The page can be reached from this machine alone.
    """

    run_folder: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(name="run", metavar="RUN")] = None
    """A run folder whose policy drives."""
    _: KW_ONLY
    case: str | None = None
    """Which flow is opened first: a shipped one by name, or the path of a case file; with a run, its own case file."""
    port: int | None = None
    """Of the page; when not given 8420, or any if that is taken."""
    browser: bool = True
    """Open the browser; the address is printed in any case."""

    def run(self) -> int:
        try:
            from manywake.play import server, session
            from manywake.play.hub import Hub
            from manywake.play.training import Training
        except ImportError as error:
            raise RuntimeError(
                f"play: a package is missing ({error}); install it with: pip install 'manywake[play]'"
            ) from error

        offers, training = session.shipped(), None
        if self.run_folder is not None:
            opened = api.load_run(self.run_folder, self.case)
            simulation = of_flow(opened)
            first, offer = f"run {opened.folder.name}", session.Offer(simulation.chosen, simulation)
            training = Training(opened.run, simulation.flows[0].baseline.free.get("c_d"))
        else:
            chosen = load.choose(self.case or load.DEFAULT)
            first, offer = chosen.definition.name, session.Offer(chosen)
        with_own = {first: offer} | {name: each for name, each in offers.items() if name != first}
        where = server.bound(self.port)
        playing = session.Session(with_own, first, Hub(), None if training is None else first)
        serving = server.Server(playing, where, training)
        say(f"page: {serving.address}")
        say("Ctrl-C ends it")
        with _opener(serving.address) as show:
            try:
                serving.run(show if self.browser else None)
            except KeyboardInterrupt:
                say("ended")
        return 0


@contextmanager
def _opener(address: str) -> Iterator:
    """Give what opens the browser at an address that no other user of the machine can read.

    The command line of a browser can be read by all. So the browser is given a file that only its user can read, which
    leads on to the address; it is deleted at the end.
    """
    handle, name = tempfile.mkstemp(prefix="manywake-play-", suffix=".html")  # its mode is 0600
    try:
        with os.fdopen(handle, "w") as file:
            file.write(f'<!doctype html><meta http-equiv="refresh" content="0; url={html.escape(address)}">\n')
        yield lambda: webbrowser.open(Path(name).as_uri())
    finally:
        Path(name).unlink(missing_ok=True)
