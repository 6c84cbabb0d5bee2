"""What the commands show: bars while something long goes on, tables of numbers, JSON as the last line."""

import json
import os
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from manywake.learn.rollout import Episode
from manywake.learn.rows import Shares

console = Console(stderr=True)

LINES = 20
"""Of a training's progress in a file."""

Json = Annotated[bool, tyro.conf.arg(help="Print one JSON object as the last line.")]
Output = Annotated[Path, tyro.conf.arg(aliases=["-o"], metavar="FILE")]


class Bar(Progress):
    """Shows progress(what, share) as a bar for each work under way, and a line for each that was done meanwhile."""

    def __init__(self) -> None:
        super().__init__("{task.description}", BarColumn(), TimeElapsedColumn(), console=console)

    def __call__(self, what: str, share: float) -> None:
        task = next((task for task in self.tasks if task.description == what), None)
        if share < 1.0:
            self.update(task.id if task else self.add_task(what, total=1.0), completed=share)
        elif task:
            self.remove_task(task.id)
            say(f"{what}: {task.elapsed:.0f} s")


class Episodes(Progress):
    """A bar of a training's episodes, in 80 columns: how many, how long still, how the newest were, how many lost."""

    def __init__(self, total: int, done: int, on: Console = console):
        columns = BarColumn(20), MofNCompleteColumn(), TimeRemainingColumn(), "left", "{task.fields[numbers]}"
        super().__init__(*columns, console=on)
        self.shares, self._told = Shares(), done
        self.bar = self.add_task("episodes", total=total, completed=done, numbers="")

    def show(self, episodes: list[Episode], shares: Shares, failures: int) -> None:
        """Take a block of episodes; as `train.Show`. Where no bar can move, as in a file, a line tells now and then."""
        self.shares, numbers = shares, _numbers(episodes, failures)
        self.update(self.bar, advance=len(episodes), numbers=numbers)
        done, total = (int(of or 0) for of in (self.tasks[0].completed, self.tasks[0].total))
        if not self.console.is_terminal and done - self._told >= total / LINES:
            self._told = done
            self.console.print(escape(f"episode {done} of {total}: {numbers}"), highlight=False, soft_wrap=True)

    def spent(self) -> str:
        """Return where the time of the slots and of the learner went; nothing before the first update."""
        parts, total = vars(self.shares), sum(vars(self.shares).values())
        return ", ".join(f"{name} {value / total:.0%}" for name, value in parts.items() if value > total / 200)


def _numbers(episodes: list[Episode], failures: int) -> str:
    whole = [episode for episode in episodes if not episode.terminated] or episodes
    lost = f" lost {failures}" if failures else ""
    if not all({"c_d", "c_l"} <= set(episode.readings) for episode in whole):
        return f"reward {sum(e.rewards.sum() for e in whole) / len(whole):.4g}{lost}"
    means = [sum(e.readings[name][len(e.rewards) // 2 :].mean() for e in whole) / len(whole) for name in ("c_d", "c_l")]
    return f"C_D {means[0]:.3f} C_L {means[1]:+.3f}{lost}"


def say(text: str) -> None:
    """Print a line beside the bars, brackets and all."""
    console.print(escape(text), highlight=False, soft_wrap=True)


def table(rows: Sequence[tuple[str, ...]], title: str | None = None) -> None:
    """Print rows, the first of them the heads of the columns."""
    head, *rest = rows
    shown = Table(title=None if title is None else escape(title), title_justify="left", title_style="bold")
    for name in head:
        shown.add_column(escape(name), overflow="fold")  # nothing is cut off
    for row in rest:
        shown.add_row(*map(escape, row))
    Console().print(shown)


def numbers(found: dict[str, Any], as_json: bool) -> None:
    """Print named numbers as a table, or as JSON."""
    if as_json:
        print(json.dumps(found))
        return
    rows = [(key, f"{value:.6g}" if isinstance(value, float) else str(value)) for key, value in found.items()]
    table([("", ""), *rows])


def ending(work: Callable[[], int]) -> None:
    """Run a command, and end the process by its status: 2 and a line for an error, 130 when it was stopped."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # a batch system's polite request to stop is as Ctrl-C
    try:
        sys.exit(work())
    except (KeyboardInterrupt, SystemError) as error:  # a kernel that is interrupted returns a SystemError
        if not _interrupted(error):
            raise
        say("stopped")
        if any(not thread.daemon for thread in threading.enumerate() if thread is not threading.main_thread()):
            sys.stdout.flush()
            os._exit(130)  # a thread that still plays would be waited for, and none can be stopped
        sys.exit(130)
    except (ValueError, RuntimeError, OSError) as error:
        console.print("[red]error:[/] ", end="")
        say(str(error))
        sys.exit(2)


def _interrupted(error: BaseException | None) -> bool:
    """Return whether an error, or one that it came of, is an interrupt; kernels within kernels make a chain of them."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None
