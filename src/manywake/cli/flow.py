"""manywake validate, manywake baseline: what is known of a flow before any training."""

import dataclasses
import json
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console
from rich.table import Table

from manywake.case import task as tasks
from manywake.cli import options
from manywake.cli.show import Bar, Json, numbers
from manywake.suite import load
from manywake.suite.load import Chosen, Definition

CaseName = Annotated[str, tyro.conf.arg(help=f"Which flow: {', '.join(load.names())}, or the path of a case file.")]


def validate_command(definition: Definition, name: str) -> type:
    """Return the command, with the settings of a case as its options."""
    Own: Any = options.settings(definition, "default", task=False)

    @dataclasses.dataclass(frozen=True)
    class Validate:
        """Check the solver against published references, on the mesh and time step that training uses."""

        settings: tyro.conf.OmitArgPrefixes[Own]
        """Settings of the case, as its file has them."""
        case: CaseName = name
        recompute: bool = False
        """Also recompute the reference of the controlled flows: twice as fine a mesh, half the time step (10 minutes).
        """
        json: Json = False

        def run(self) -> int:
            """Print the table; 1 when a check fails."""
            return _validate(load.override(definition, "default", options.overrides(self.settings)), self)

    return Validate


def _validate(chosen: Chosen, asked: Any) -> int:
    from manywake.flow import store, validate

    mixing = tasks.matrix(chosen.task, len(chosen.case.actuators))[:, 0]
    file = chosen.definition.file
    with Bar() as bar:
        flow = store.flow(chosen.case, bar)
        kept = None if file is None else file.with_suffix(".json")
        checks = validate.run(flow, chosen.definition.references, mixing, kept, bar, asked.recompute)
    table = Table("quantity", "ours", "reference", "tolerance", "pass", "source", title=f"validate {asked.case}")
    for check in checks:
        passed = "[green]yes[/]" if check.passed else "[red]NO[/]"
        table.add_row(
            check.name, f"{check.ours:.6g}", f"{check.reference:.6g}", _tolerance(check), passed, check.source
        )
    Console().print(table)
    every = all(check.passed for check in checks)
    if asked.json:
        rows = [{**dataclasses.asdict(check), "passed": check.passed} for check in checks]
        print(json.dumps({"passed": every, "checks": rows}))
    return 0 if every else 1


def _tolerance(check) -> str:
    if check.kind == "relative":
        return f"{check.tolerance:.2%}"
    return f"{check.tolerance:.3g}" if check.kind == "absolute" else check.kind


def baseline_command(definition: Definition, name: str) -> type:
    """Return the command, with the settings of a case as its options."""
    Own: Any = options.settings(definition, "default", task=False)

    @dataclasses.dataclass(frozen=True)
    class Baseline:
        """Describe the baseline of a case (mesh, start state, mean flow), check its hash, or make it again."""

        settings: tyro.conf.OmitArgPrefixes[Own]
        """Settings of the case, as its file has them."""
        case: CaseName = name
        make: Path | None = None
        """Make it anew and write it to this file."""
        json: Json = False

        def run(self) -> int:
            """Print what it is."""
            return _describe(load.override(definition, "default", options.overrides(self.settings)), self)

    return Baseline


def _describe(chosen: Chosen, asked: Any) -> int:
    from manywake.flow import baseline, store

    with Bar() as bar:
        if asked.make is None:
            base = store.get(chosen.case, bar)
        else:
            base = baseline.make(chosen.case, progress=bar)
            baseline.save(base, asked.make)
    described = {
        "case": asked.case,
        "flow_digest": base.flow_digest,
        "digest": base.digest(),
        "recipe": base.recipe,
        "check": "content matches its hash and its case",
        "triangles": len(base.mesh.triangles),
        **dataclasses.asdict(base.shedding),
        "strouhal": base.shedding.strouhal(chosen.case.convective_time),
        **{f"steady {name}": value for name, value in base.steady.items()},
    }
    numbers(described, asked.json)
    return 0
