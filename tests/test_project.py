"""What stands in several files of the checkout is the same in all of them."""

import re
import tomllib
from pathlib import Path

from .slow.test_mutations import DEFECTS

ROOT = Path(__file__).parents[1]


def text(name: str) -> str:
    return (ROOT / name).read_text()


def test_the_version_is_the_same_wherever_it_stands():
    version = tomllib.loads(text("pyproject.toml"))["project"]["version"]
    assert re.findall(r"^version: (.+)$", text("CITATION.cff"), re.MULTILINE) == [version]
    assert re.findall(r"^## (.+)$", text("CHANGELOG.md"), re.MULTILINE)[0] == version


def test_the_hooks_of_pre_commit_are_what_make_lint_runs():
    (recipe,) = re.findall(r"^lint:.*\n((?:\t.*\n)+)", text("Makefile"), re.MULTILINE)
    wanted = [line.strip().replace("$(BIN)", ".venv/bin") for line in recipe.splitlines()]
    assert re.findall(r"entry: (.+)", text(".pre-commit-config.yaml")) == wanted


def test_ci_tries_every_python_from_the_oldest_that_is_supported():
    oldest = tomllib.loads(text("pyproject.toml"))["project"]["requires-python"].removeprefix(">=")
    (pythons,) = re.findall(r"python: \[(.+)\]", text(".github/workflows/ci.yml"))
    versions = [tuple(map(int, version.strip('" ').split("."))) for version in pythons.split(",")]
    assert versions[0] == tuple(map(int, oldest.split(".")))
    assert versions == [(3, minor) for minor in range(versions[0][1], versions[-1][1] + 1)]


def test_every_file_that_the_guide_for_contributors_names_is_there():
    named = re.findall(r"`((?:[\w-]+/)*[\w-]+\.(?:py|md|toml|cff))`", text("CONTRIBUTING.md"))
    assert len(named) > 40
    named = [name for name in named if "NAME" not in name]
    missing = [name for name in named if not ((ROOT / name).exists() or (ROOT / "src/manywake" / name).exists())]
    assert missing == []


def test_every_defect_on_purpose_still_has_its_place():
    assert [d.what for d in DEFECTS if text(f"src/manywake/{d.file}").count(d.right) != 1] == []
