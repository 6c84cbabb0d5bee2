"""What the commands show fits where it is shown."""

import io
from dataclasses import replace

import numpy as np
from rich.console import Console

from manywake.cli.show import Episodes
from manywake.learn.rollout import Episode
from manywake.learn.rows import Shares


def episode(**readings: float) -> Episode:
    series = {name: np.full(4, value) for name, value in readings.items()}
    numbers = np.zeros((4, 1))
    return Episode(0, np.zeros(4), numbers, numbers[0], numbers, np.zeros(4), np.full(4, -1234.5), series, False, 1, 1)


def rendered(bar: Episodes) -> list[str]:
    out = io.StringIO()
    Console(file=out, width=80).print(bar.get_renderable())
    return out.getvalue().rstrip("\n").split("\n")


def test_the_line_of_a_training_fits_80_columns_with_bar_count_time_left_drag_and_lift():
    bar = Episodes(102400, 51200, Console(file=io.StringIO(), width=80))
    bar.show([episode(c_d=3.1234, c_l=-0.5678)] * 1024, Shares(flow=3.0, learner=1.0), 12)
    (line,) = rendered(bar)
    assert len(line) <= 80 and "…" not in line
    for part in ("━━━", " 52224/102400", "-:--:-- left", "C_D 3.123", "C_L -0.568", "lost 12"):
        assert part in line
    assert bar.spent() == "flow 75%, learner 25%"


def test_the_line_has_the_reward_where_there_is_no_drag():
    bar = Episodes(102400, 512, Console(file=io.StringIO(), width=80))
    assert bar.spent() == ""
    bar.show([episode(), replace(episode(), terminated=True)], Shares(), 0)
    (line,) = rendered(bar)
    assert "514/102400" in line and "reward -4938" in line and len(line) <= 80


def test_in_a_file_a_training_tells_now_and_then_how_far_it_is():
    out = io.StringIO()
    bar = Episodes(400, 0, Console(file=out, width=80))
    for _ in range(25):
        bar.show([episode(c_d=3.1, c_l=0.1)] * 16, Shares(), 0)
    lines = out.getvalue().splitlines()
    assert lines[0] == "episode 32 of 400: C_D 3.100 C_L +0.100"
    assert len(lines) == 12


def test_on_a_screen_it_tells_by_the_bar_alone():
    out = io.StringIO()
    bar = Episodes(16, 0, Console(file=out, width=80, force_terminal=True))
    bar.show([episode(c_d=3.1, c_l=0.1)] * 16, Shares(), 0)
    assert "episode 16" not in out.getvalue()
