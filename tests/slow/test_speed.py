"""The solver stays as fast as it was, beside what is measured in the same run: no figure of a machine is assumed."""

import statistics
import sys

from benchmarks import peers, roofline


def test_a_step_takes_no_more_than_four_times_what_its_arithmetic_and_traffic_must():
    assert roofline.measure()["share_of_roof"] > 0.25  # measured: 0.40 to 0.48


def test_a_flow_is_two_orders_cheaper_than_a_careful_users_and_lanes_give_a_part_of_that():
    theirs = peers.contest([sys.executable, "scikit.py", "--steps", "40"])
    ours = peers.contest([sys.executable, "ours.py", "1", "8"])
    one, eight = (statistics.median(ours["widths"][w]["cpu_ms"]) / ours["time_step"] for w in ("1", "8"))
    scikit = statistics.median(theirs["cpu_ms"]) / 5e-4
    assert scikit / eight > 150  # measured: 285 to 357
    assert scikit / one > 35  # measured: 62 to 73
    assert one / eight > 2.5  # measured: 4.4 to 4.7
