"""The commands and code blocks of README, tutorial and how-to pages, and how they are run.

A comment before a block, which no reader sees, says when: without one in `make test`, `<!-- slow -->` in `make
test-all`, `<!-- not run: REASON -->` nowhere. A block of Python that begins with `# NAME.py` is a case file: it is
written and loaded. All other Python of a page runs in order in one namespace, shell blocks line by line, all in one
folder. Blocks of other languages are shown only: what a command prints, say.
"""

import os
import re
import runpy
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import matplotlib
from markdown_it import MarkdownIt

from manywake.machine import compile as kernels

ROOT = Path(__file__).parents[1]
HOW_TO = (
    *("own-flow", "own-reward", "own-solver", "learners", "wrappers", "watch", "export", "resume", "choose", "cluster"),
    *("reproduce", "run-folder", "limits", "case-words"),
)
LEARNERS = "stable-baselines3", "cleanrl", "torchrl", "skrl", "rllib"
PAGES = (
    *("README.md", "docs/tutorial.md"),
    *(f"docs/{name}.md" for name in HOW_TO),
    *(f"docs/learners/{name}.md" for name in LEARNERS),
)
RUN, SHOWN = ("bash", "python"), ("text", "json")
FAST, SLOW, NEVER = "fast", "slow", "never"
MARK = re.compile(r"<!-- (?:(slow)|not run: (\S.*)) -->\n")


@dataclass(frozen=True)
class Block:
    """A block of code. mark: FAST, SLOW or NEVER; None where the comment before it says nothing that is known."""

    page: str
    line: int
    language: str
    text: str
    mark: str | None

    @property
    def place(self) -> str:
        return f"{self.page}:{self.line}"

    @property
    def file(self) -> str | None:
        """The name of the file that a block of Python is."""
        named = re.match(r"# (\w+\.py)\n", self.text) if self.language == "python" else None
        return named and named[1]


def blocks(page: str) -> list[Block]:
    """Return the blocks of a page in their order."""
    found, before = [], None
    for token in MarkdownIt("commonmark").parse((ROOT / page).read_text()):
        if token.type == "fence":
            said = MARK.fullmatch(before) if before is not None else None
            mark = FAST if before is None else None if said is None else SLOW if said[1] else NEVER
            found.append(Block(page, (token.map or [0])[0] + 1, token.info.strip(), token.content, mark))
        before = token.content if token.type == "html_block" else None
    return found


def commands(block: Block) -> list[str]:
    """Return the lines of a shell block, without comments alone."""
    lines = block.text.replace("\\\n", " ").splitlines()
    return [line for line in lines if line.strip() and not line.lstrip().startswith("#")]


def play(page: str, marks: tuple[str, ...], folder: Path) -> None:
    """Run the blocks of a page that have one of some marks, in a folder, which is the working folder."""
    (folder / ".venv").symlink_to(sys.prefix)  # where the README has it
    namespace: dict[str, object] = {"__name__": "__main__"}
    for block in blocks(page):
        if block.language not in RUN or block.mark not in marks:
            continue
        if block.file:
            (folder / block.file).write_text(block.text)
            runpy.run_path(block.file, run_name="manywake_case")
        elif block.language == "python":
            exec(compile("\n" * block.line + block.text, str(ROOT / page), "exec"), namespace)
        else:
            for line in commands(block):
                done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, env=environment())
                assert done.returncode == 0, f"{block.place}: {line}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"


def environment() -> dict[str, str]:
    """Return what commands run with: this Python's folder first, kernels and fonts that are there already."""
    kept = {
        "PATH": os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]),
        "NUMBA_CACHE_DIR": os.environ.get("NUMBA_CACHE_DIR") or kernels._cache_folder(),
        "MPLCONFIGDIR": matplotlib.get_configdir(),
    }
    return {**os.environ, **kept}
