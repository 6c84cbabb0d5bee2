"""Slow: a new case's baseline is made once, whoever wants it."""

import os
import subprocess
import sys

WANT = """
import dataclasses
from manywake.flow import store
from manywake.suite.cylinder_jets import CASE
made = []
case = dataclasses.replace(CASE, time_step=6e-4, spin_up=30.0)
base = store.get(case, lambda what, share: made.append(what))
print(base.digest(), len(made) > 0, base.statistics.kind)
"""


def test_two_processes_that_want_a_new_baseline_make_it_once(tmp_path):
    env = os.environ | {"XDG_CACHE_HOME": str(tmp_path), "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    both = [
        subprocess.Popen([sys.executable, "-c", WANT], env=env, stdout=subprocess.PIPE, text=True) for _ in range(2)
    ]
    answers = [process.communicate(timeout=540)[0].split() for process in both]
    assert [process.returncode for process in both] == [0, 0]
    digests, made, _ = zip(*answers, strict=True)
    assert digests[0] == digests[1]
    assert sorted(made) == ["False", "True"]
    files = sorted(path.suffix for path in (tmp_path / "manywake" / "baselines").iterdir())
    assert files.count(".npz") == 1
    assert not {".tmp", ".partial"} & set(files)
