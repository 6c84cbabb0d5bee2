"""Commands on a case, whose settings are their options; manywake validate, mesh, baseline."""

import argparse
import dataclasses
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import tyro
from rich.console import Console
from rich.table import Table

from manywake.case import task as tasks
from manywake.case.case import Case
from manywake.cli.show import Bar, Json, Output, numbers
from manywake.suite import load
from manywake.suite.load import Chosen, Definition, Setting

_SENSORS = ("points.", "noise.")
CaseName = Annotated[str, tyro.conf.arg(help=f"Which flow: {', '.join(load.names())}, or the path of a case file.")]


@dataclass(frozen=True)
class OnCase:
    """A command on a case; `command` adds the options that are that case's."""

    definition: ClassVar[Definition]
    case: CaseName = load.DEFAULT
    settings: Any = None
    """Settings of the case, as its file has them."""
    json: Json = False

    def overrides(self) -> dict[str, Any]:
        """Return the settings that are not what the case's file says, by name."""
        given, fields = vars(self.settings), dataclasses.fields(self.settings)
        return {f.name.replace("__", "."): given[f.name] for f in fields if given[f.name] != f.default}

    def chosen(self, protocol: str = "default") -> Chosen:
        return load.override(self.definition, protocol, self.overrides())

    def flow(self) -> Case:
        """Return the case with its settings, whether it has a task or not."""
        return load.override_case(self.definition, self.overrides())


def first(words: list[str]) -> argparse.Namespace:
    """Return case and protocol among the words of a command: they choose the defaults that the others override."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--case", default=load.DEFAULT)
    parser.add_argument("--protocol", default="default")
    return parser.parse_known_args(words)[0]


def command(kind: type[OnCase], definition: Definition, name: str | None = None, **defaults: Any) -> Any:
    """Return a command on a case with its settings as options; one that has a protocol takes the task's too."""
    protocol = defaults.get("protocol")
    found = load.settings(definition, protocol) if protocol else load.case_settings(definition.case)
    own = [_option(name, s) for name, s in found.items() if protocol or not name.startswith(_SENSORS)]
    made: Any = dataclasses.make_dataclass("Settings", own, frozen=True)
    fields: list[Any] = [("settings", Annotated[made, tyro.conf.OmitArgPrefixes], made())]
    if protocol:
        fields.append(("protocol", Literal[tuple(definition.protocols)], protocol))
    also = {"__doc__": kind.__doc__, "definition": definition}
    whole = dataclasses.make_dataclass(kind.__name__, fields, bases=(kind,), namespace=also, frozen=True)
    return Annotated[whole, tyro.conf.subcommand(name or kind.__name__.lower(), default=whole(**defaults))]


def _option(name: str, setting: Setting) -> tuple[str, Any, Any]:
    kind, default, help, words = setting.type, setting.value, setting.help, None
    if isinstance(kind, tuple):  # a word that is none of them is refused at the door, as all that does not fit
        words, kind = f"{{{','.join(kind)}}}", str
    if name.startswith("points."):
        kind, default, help = kind | None, None, f"{help} {len(setting.value)} in the case's file."
    option = tyro.conf.arg(name=name.replace("_", "-"), help=help, metavar=words)
    return name.replace(".", "__"), Annotated[kind, option], default  # type: ignore[valid-type]


@dataclass(frozen=True)
class Validate(OnCase):
    """Check the solver against published references, on the mesh and time step that training uses."""

    recompute: bool = False
    """Also recompute the reference of the controlled flows, and keep it beside the case's file: twice as fine a mesh,
    half the time step (10 minutes)."""

    def run(self) -> int:
        from manywake.flow import store, validate

        case, task = self.flow(), self.definition.task
        mixing = tasks.matrix(task, len(case.actuators))[:, 0] if task is not None else None
        kept = self.definition.file and self.definition.file.with_suffix(".json")
        references = self.definition.references
        if case.reynolds != self.definition.case.reynolds:  # of those that name none it is that of the file
            references = tuple(each for each in references if getattr(each, "reynolds", None) is not None)
        with Bar() as bar:
            flow = store.flow(case, bar)
            checks = validate.run(flow, references, mixing, kept, bar, self.recompute)
        table = Table("quantity", "ours", "reference", "tolerance", "pass", "source", title=f"validate {self.case}")
        for check in checks:
            passed = "" if check.kind == "reported" else "[green]yes[/]" if check.passed else "[red]NO[/]"
            within = {"relative": f"{100 * check.tolerance:.3g}%", "absolute": f"{check.tolerance:.3g}"}
            values = f"{check.ours:.6g}", f"{check.reference:.6g}", within.get(check.kind, check.kind)
            table.add_row(check.name, *values, passed, check.source)
        Console().print(table)
        every = all(check.passed for check in checks)
        if self.json:
            rows = [{**dataclasses.asdict(check), "passed": check.passed} for check in checks]
            print(json.dumps({"passed": every, "checks": rows}))
        return 0 if every else 1


@dataclass(frozen=True)
class Mesh(OnCase):
    """Draw the mesh of a case, whole and at its bodies, with actuators and sensors; no baseline is made for it."""

    output: Output = Path("mesh.png")
    """The picture, PNG."""

    def run(self) -> int:
        from manywake import plots
        from manywake.flow import store

        case = self.flow()
        made = store.mesh(case)
        plots.mesh(case, made, f"{self.case}: {len(made.triangles)} triangles", self.output)
        numbers({"file": str(self.output), "triangles": len(made.triangles), "time step": case.dt}, self.json)
        return 0


@dataclass(frozen=True)
class Baseline(OnCase):
    """Describe the baseline of a case (mesh, start state, mean flow), check its hash, or make it again."""

    make: Path | None = None
    """Make it anew and write it to this file."""

    def run(self) -> int:
        from manywake.flow import baseline, store
        from manywake.flow.readings import KINDS

        case = self.flow()
        with Bar() as bar:
            if self.make is None:
                base = store.get(case, bar)
            else:
                base = baseline.make(case, progress=bar)
                baseline.save(base, self.make)
        described: dict[str, Any] = {"case": self.case, "flow_digest": base.flow_digest, "digest": base.digest()}
        described |= {"recipe": base.recipe, "check": "content matches its hash and its case"}
        free, period = base.statistics, base.statistics.period
        starts = len(base.starts) * (baseline.PHASES if period else 1)
        described |= {"triangles": len(base.mesh.triangles), "kind": free.kind, "start states": starts}
        if period:
            described |= {"period": period, "St": case.convective_time / period}
        for name, moments in free.readings.items():
            described |= {f"{name} {kind}": value for kind, value in vars(moments).items()}
        described |= {f"{name} steady": value for name, value in base.steady.items()}
        for actuator in case.actuators:
            for kind in ("held", "smooth"):
                described[f"{actuator.on} withstood, {kind}"] = actuator.strongest * getattr(base.withstood, kind)
        if len(case.bodies) == 1 and not self.json:  # the one body has the readings of all
            of_one = tuple(f"{kind}." for kind in KINDS)
            described = {name: of for name, of in described.items() if not name.startswith(of_one)}
        numbers(described, self.json)
        return 0
