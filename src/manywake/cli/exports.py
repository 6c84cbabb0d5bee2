"""manywake movie, export, export-policy: a flow as a film or for ParaView, a policy as an ONNX graph."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from manywake.cli import show
from manywake.cli.runs import OnController, OnRun, of_flow
from manywake.cli.show import Bar, Json, Output, say
from manywake.learn import flows
from manywake.learn.controllers import Controller, Learnt
from manywake.learn.runs import Run

Folder = Annotated[Path | None, tyro.conf.arg(aliases=["-o"], metavar="DIR")]


@dataclass(frozen=True)
class Export(OnRun):
    """Play one episode of a run's newest policy, without noise, and write it as files for ParaView.

    Without a run: manywake export --case NAME, with a controller as evaluate has them; --help beside it lists the
    options.
    """

    output: Folder = None
    """Folder for the files; default RUN/paraview."""
    actions: int | None = None
    """How many are played; an episode's when not given."""
    every: int = 1
    """Actions from one frame to the next."""

    def run(self) -> int:
        from manywake import export

        folder = export.free(self.output or self.run_folder / "paraview")
        controller = Learnt(Run(self.run_folder).newest_version())
        return _written(of_flow(self.opened()), controller, folder, self.actions, self.every, self.json)


@dataclass(frozen=True)
class ExportCase(OnController):
    """Play one episode of a controller of no run, and write it as files for ParaView."""

    output: Folder = None
    """Folder for the files; default paraview-<case>."""
    every: int = 1
    """Actions from one frame to the next."""

    def run(self) -> int:
        from manywake import export

        folder = export.free(self.output or Path(f"paraview-{self.definition.name}"))
        simulation, controller = self.opened()
        return _written(simulation, controller, folder, None, self.every, self.json)


@dataclass(frozen=True)
class Movie(OnRun):
    """Film one episode of a run's newest policy, without noise, below the flow uncontrolled.

    Without a run: manywake movie --case NAME, with a controller as evaluate has them; --help beside it lists the
    options.
    """

    output: Output = Path("wake.mp4")
    """The file, .mp4 or .gif."""
    actions: int | None = None
    """How many are played; an episode's when not given."""

    def run(self) -> int:
        from manywake import movie

        path, controller = movie.checked(self.output), Learnt(Run(self.run_folder).newest_version())
        return _filmed(of_flow(self.opened()), controller, path, self.actions, self.json)


@dataclass(frozen=True)
class MovieCase(OnController):
    """Film one episode of a controller of no run below the flow uncontrolled."""

    output: Output = Path("wake.mp4")
    """The file, .mp4 or .gif."""

    def run(self) -> int:
        from manywake import movie

        path = movie.checked(self.output)
        simulation, controller = self.opened()
        return _filmed(simulation, controller, path, None, self.json)


@dataclass(frozen=True)
class ExportPolicy:
    """Write a run's newest policy, its normaliser included, as an ONNX graph: observation -> action.

    Nothing is played and no case file is needed.
    """

    run_folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
    """Run folder, as manywake train left it."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"], metavar="FILE")] = None
    """The file; default RUN/policy.onnx."""
    json: Json = False

    def run(self) -> int:
        from manywake.learn import onnx

        path = self.output or self.run_folder / "policy.onnx"
        policy = onnx.write(Run(self.run_folder), path)
        sizes = {"observed values": len(policy.mean), "actions": len(policy.log_std)}
        show.numbers({"file": str(path), "policy after updates": policy.version, **sizes}, self.json)
        return 0


def _filmed(simulation: flows.Flows, controller: Controller, path: Path, actions: int | None, as_json: bool) -> int:
    """Film the flow, or each of a task of several Reynolds numbers, and show what was written."""
    from manywake import movie

    several, found = len(simulation.flows) > 1, []
    with Bar() as bar:
        for flow in simulation.flows:
            named = path.with_stem(f"{path.stem}-{flow.case.reynolds:g}") if several else path
            found.append(movie.movie(flow, simulation.task, controller, named, actions, progress=bar))
    for each in found:
        if each.diverged:
            say(f"{each.path}: the controlled flow blew up, there the film ends")
    files, blown = [str(each.path) for each in found], any(each.diverged for each in found)
    films = files if as_json else ", ".join(files)
    show.numbers({"films": films, "frames": sum(each.frames for each in found), "blew up": blown}, as_json)
    return 0


def _written(
    simulation: flows.Flows, controller: Controller, folder: Path, actions: int | None, every: int, as_json: bool
) -> int:
    """Export the flow, or each of a task of several Reynolds numbers, and show what was written."""
    from manywake import export

    several, found = len(simulation.flows) > 1, []
    with Bar() as bar:
        for flow in simulation.flows:
            name = f"flow-{flow.case.reynolds:g}" if several else "flow"
            found.append(export.export(flow, simulation.task, controller, folder, actions, every, name, bar))
    for each in found:
        if each.diverged:
            say(f"{each.collection.name}: the flow blew up after {each.times[-1]:g} L/U; it has no more frames")
    files = [str(each.collection) for each in found]
    shown = files if as_json else ", ".join(files)
    frames, end = sum(len(each.times) for each in found), max(each.times[-1] for each in found)
    blown = any(each.diverged for each in found)
    show.numbers({"open in ParaView": shown, "frames": frames, "end [L/U]": end, "blew up": blown}, as_json)
    return 0
