"""Whether a change kept the paper's case to the bit: a training of two updates, here and at another commit.

Command: make same BASE=<commit>, or python -m benchmarks.same <commit>
Both trees train with this interpreter, one after the other. Compared are the policy's hash, the rows of episodes.csv
but for times, and the arrays of the operators by content and not by name. Prints one JSON object; 1 where bits differ.
"""

import csv
import hashlib
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np


def trained(tree: Path, folder: Path) -> str:
    """Train in a tree of the source; return the policy's hash."""
    words = ["train", "--seed", "0", "--episodes", "32", "--run", str(folder), "--json"]
    path = {"PYTHONPATH": str(tree / "src")}
    done = subprocess.run(
        [sys.executable, "-m", "manywake.cli", *words],
        env=os.environ | path,
        cwd=tree,
        stdout=subprocess.PIPE,
        check=True,
    )
    return json.loads(done.stdout.decode().splitlines()[-1])["policy_sha256"]


def rows(folder: Path) -> list[dict[str, str]]:
    """Return the table of episodes without times."""
    with open(folder / "episodes.csv", newline="") as file:
        return [{name: value for name, value in row.items() if not name.endswith("_s")} for row in csv.DictReader(file)]


def arrays(folder: Path) -> dict[str, str]:
    """Return the names of all arrays of the operators by the hash of their content."""
    with np.load(folder / "operators.npz") as data:
        found = {name: np.ascontiguousarray(data[name]) for name in data.files}
    return {hashlib.sha256(f"{a.dtype}{a.shape}".encode() + a.tobytes()).hexdigest(): name for name, a in found.items()}


def compare(ours: Path, theirs: Path) -> dict[str, object]:
    """Return in which columns rows differ, and the arrays that one side alone has."""
    a, b = rows(ours), rows(theirs)
    both = [name for name in a[0] if name in b[0]]
    mine, other = arrays(ours), arrays(theirs)
    return {
        "columns_compared": both,
        "columns_that_differ": [name for name in both if [row[name] for row in a] != [row[name] for row in b]],
        "arrays_alike": len(mine.keys() & other.keys()),
        "arrays_here_alone": sorted(name for key, name in mine.items() if key not in other),
        "arrays_there_alone": sorted(name for key, name in other.items() if key not in mine),
    }


def main(base: str) -> int:
    """Compare this tree with a commit."""
    here = Path(__file__).parents[1]
    with tempfile.TemporaryDirectory() as name:
        there = Path(name) / "tree"
        subprocess.run(
            ["git", "worktree", "add", "--detach", str(there), base], cwd=here, check=True, capture_output=True
        )
        try:
            hashes = [trained(tree, Path(name) / run) for tree, run in ((here, "here"), (there, "there"))]
            found = compare(Path(name) / "here", Path(name) / "there")
        finally:
            subprocess.run(["git", "worktree", "remove", "--force", str(there)], cwd=here, check=True)
    same = hashes[0] == hashes[1] and not found["columns_that_differ"]
    print(json.dumps({"same": same, "policy_sha256": hashes, **found}, indent=1))
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
