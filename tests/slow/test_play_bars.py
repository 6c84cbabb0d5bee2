"""What the page is promised to do, measured: pytest -s tests/slow/test_play_bars.py, on a machine that is idle."""

import os
import signal
import statistics
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

from manywake import api

from .. import chromium
from ..playing import drawn, page

pytestmark = pytest.mark.skipif(chromium.PROGRAM is None, reason="no chromium is installed; apt-get install chromium")
MINUTES = float(os.environ.get("MANYWAKE_MINUTES", 3))
"""Of play, for its memory."""
ANSWER = """new Promise((done) => {
  const slider = document.querySelector('#hand input'), begun = performance.now();
  slider.value = slider.value > 0 ? -1 : 1;
  slider.dispatchEvent(new Event('input'));
  const before = manywake().numbers[5] - manywake().numbers[7];
  const look = () => {
    const now = manywake().numbers[5] - manywake().numbers[7];
    if (Math.abs(now - before) > 0.005) done(performance.now() - begun); else requestAnimationFrame(look);
  };
  look();
})"""
COUNT = """new Promise((done) => {
  const begun = performance.now(), first = manywake().numbers[0];
  let last = 0, count = 0;
  const look = () => {
    if (manywake().number !== last) { last = manywake().number; count += 1; }
    const passed = (performance.now() - begun) / 1000;
    if (passed < 10) requestAnimationFrame(look); else done([count / passed, (manywake().numbers[0] - first) / passed]);
  };
  look();
})"""


class Command:
    """manywake play in a process of its own."""

    def __init__(self, process: subprocess.Popen, address: str):
        self.process, self.address = process, address
        self.port, _, self.key = address.removeprefix("http://127.0.0.1:").partition("/#key=")

    def memory(self) -> float:
        """Return what it holds in memory, in MB."""
        return int(Path(f"/proc/{self.process.pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


@contextmanager
def playing():
    words = [sys.executable, "-m", "manywake.cli", "play", "--no-browser"]
    with subprocess.Popen(words, stderr=subprocess.PIPE, text=True) as process:
        yield Command(process, process.stderr.readline().split()[-1])
        process.send_signal(signal.SIGINT)


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with chromium.browser(tmp_path_factory.mktemp("chromium")) as made:
        yield made


def test_frames_answers_and_what_a_policy_saves(browser):
    tab = browser.tab()
    tab.size(1280, 860)
    begun = time.monotonic()
    with playing() as command:
        tab.open(command.address)
        tab.until("manywake() && manywake().number > 0", 60)
        first = time.monotonic() - begun
        tab.until("manywake().numbers[0] > 2")
        frames, pace = tab.js(COUNT)
        answers = []
        for _ in range(10):
            tab.js("document.querySelector('#reset').click()")
            tab.until("0.5 < manywake().numbers[0] && manywake().numbers[0] < 2")
            answers.append(tab.js(ANSWER))
        tab.js("document.querySelector('#reset').click()")
        tab.js("document.querySelector('[data-value=policy]').click()")
        tab.until("manywake().numbers[0] > 40 && manywake().numbers[0] < 45", 120)
        saved = tab.js("manywake().numbers[2]")
    said = api.judge(controller="pretrained").long_run.drag_reduction
    print(f"\nfirst frame {first:.1f} s; {frames:.1f} frames a second at {pace:.2f} L/U a second")
    print(f"slider to drag: median {statistics.median(answers):.0f} ms, largest {max(answers):.0f} ms")
    print(f"the policy saves {saved:.2%} on the page, {said:.2%} in an evaluation")
    assert saved >= 0.07 and saved == pytest.approx(said, abs=0.005)
    assert first <= 5
    assert pace > 4.8 and frames >= 20
    assert statistics.median(answers) <= 150


def test_memory_is_flat_though_a_page_reads_nothing():
    with playing() as command:
        with page(command, command.key) as reading, page(command, command.key):
            end, held = time.monotonic() + 60 * MINUTES, []
            while time.monotonic() < end:
                said = reading.recv(timeout=60)
                if isinstance(said, bytes):
                    drawn(reading, said)
                if not held or time.monotonic() > held[-1][0] + 5:
                    held.append((time.monotonic(), command.memory()))
    late = [memory for _, memory in held[len(held) // 3 :]]
    shown = ", ".join(f"{memory:.0f}" for _, memory in held[:: max(len(held) // 8, 1)])
    print(f"\nmemory over {MINUTES:g} minutes, in MB: {shown}")
    assert late[-1] - late[0] < 5
