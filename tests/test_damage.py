"""What arrives from outside, bad words and damaged folders, is refused in a line, and nothing is left behind.

The commands run in this process, on copies of one short run.
"""

import io
import json
import pickle
import shutil
import signal
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from stable_baselines3 import PPO

from manywake import load_policy
from manywake.cli import main

from .external import Trap

pytestmark = pytest.mark.alone

SHORT = ["--actions", "2", "--update-period", "2", "--episodes", "6", "--hidden", "8", "--engine", "serial"]


@pytest.fixture
def command(monkeypatch, capfd):
    """Return a function that runs a command in this process, and gives its status and what it printed."""
    before = signal.getsignal(signal.SIGTERM)

    def run(*words) -> tuple[int, str]:
        monkeypatch.setattr(sys, "argv", ["manywake", *map(str, words)])
        capfd.readouterr()
        with pytest.raises(SystemExit) as ended:
            main.main()
        printed = capfd.readouterr()
        return ended.value.code, " ".join((printed.out + printed.err).replace("│", " ").split())

    yield run
    signal.signal(signal.SIGTERM, before)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Return the folder of a run that ended."""
    folder = tmp_path_factory.mktemp("whole") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["manywake", "train", *SHORT, "--run", str(folder)])
        with pytest.raises(SystemExit) as ended:
            main.main()
    assert ended.value.code == 0
    return folder


def paths(folder: Path) -> set[Path]:
    """Return all files and folders below a folder, but for locks."""
    return {path for path in folder.rglob("*") if path.name != ".lock"}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--batch-size 1", "batch_size: got 1, wanted a whole number, at least 2"),
        ("--n-epochs 0", "n_epochs: got 0, wanted a whole number, at least 1"),
        ("--update-period 0", "update_period: got 0, wanted a whole number, at least 1"),
        ("--learner-threads 0", "learner_threads: got 0, wanted a whole number, at least 1"),
        ("--hidden 0", "hidden: got (0,), wanted whole numbers, each at least 1"),
        ("--gamma 2", "gamma: got 2, wanted a number from 0 to 1"),
        ("--gae-lambda nan", "gae_lambda: got nan, wanted a number from 0 to 1"),
        ("--clip-range 0", "clip_range: got 0, wanted a number from 1e-06 to 1e+06"),
        ("--learning-rate -1", "learning_rate: got -1, wanted a number from 1e-12 to 1"),
        ("--log-std-init 100", "log_std_init: got 100, wanted a number from -20 to 2"),
        ("--episodes 8", "error: episodes: got 8, wanted a multiple of the update period 16"),
        ("--seed -1", "seed: got -1, wanted a whole number from 0 to 4294967295"),
        ("--envs 0", "envs: got 0, wanted at least 1"),
        ("--time-limit -1", "time_limit: got -1, wanted more than 0"),
        ("--episode-spread -1", "episode_spread: got -1, wanted a number, at least 0"),
        ("--address here", "address: got 'here' with engine processes, wanted it with --engine ray"),
        ("--env nosuch:thing", "env: got 'nosuch:thing', but the module 'nosuch' cannot be loaded"),
        ("--env NoSuch-v0", "env: got 'NoSuch-v0'"),
        ("--env [red]:x[/red]", "env: got '[red]:x[/red]', but the module '[red]' cannot be loaded"),
        ("--actions 1", "actions: got 1, wanted at least 2"),
        ("--envs 40", "envs: got 40, wanted at most the 16 episodes that a synced update waits for"),
    ],
)
def test_bad_words_of_a_training_are_refused_and_leave_no_folder(command, tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    status, printed = command("train", *words.split())
    assert message in printed
    assert (status, "Traceback" in printed) == (2, False)
    assert paths(tmp_path) <= {tmp_path / "runs"}


def cut(path: Path, share: float) -> None:
    """Keep the first part of a file."""
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])


def flip(path: Path) -> None:
    """Change a byte in the middle of a file."""
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0xFF
    path.write_bytes(bytes(content))


def edit(folder: Path, change) -> None:
    """Change what settings.json says."""
    data = json.loads((folder / "settings.json").read_text())
    change(data)
    (folder / "settings.json").write_text(json.dumps(data))


def both_checkpoints(how):
    def damage(folder: Path) -> None:
        for name in ("last", "previous"):
            how(folder / "checkpoints" / f"{name}.zip")

    return damage


DAMAGES = {
    "settings cut short": (
        lambda f: cut(f / "settings.json", 0.5),
        "evaluate resume replay",
        "settings.json is damaged",
    ),
    "settings that are no object": (
        lambda f: (f / "settings.json").write_text("[]"),
        "evaluate",
        "has format of something else, wanted 3",
    ),
    "settings that are no text": (lambda f: (f / "settings.json").write_bytes(b"\xff\xfe"), "evaluate", "is damaged"),
    "no settings": (lambda f: (f / "settings.json").unlink(), "evaluate resume replay", "has no settings.json; wanted"),
    "an unknown setting, of a newer version say": (
        lambda f: edit(f, lambda d: d["learning"].update(momentum=1)),
        "resume replay",
        'settings.json is damaged, or of another version (dict has unexpected extra key(s): "momentum")',
    ),
    "a setting of a wrong type": (
        lambda f: edit(f, lambda d: d["learning"].update(gamma="much")),
        "resume replay",
        "value of key 'gamma' of dict is neither float or int",
    ),
    "a setting that is not there": (
        lambda f: edit(f, lambda d: d.pop("seed")),
        "evaluate resume",
        'dict is missing required key(s): "seed"',
    ),
    "a setting out of its range": (
        lambda f: edit(f, lambda d: d["learning"].update(gamma=7.0)),
        "resume",
        "settings.json: gamma: got 7, wanted a number from 0 to 1",
    ),
    "a layout of a wrong type": (
        lambda f: edit(f, lambda d: d["layout"].update(lanes="all")),
        "resume",
        "settings.json is damaged, or of another version",
    ),
    "a record of later versions that is none": (
        lambda f: edit(f, lambda d: d.update(later=[{}])),
        "evaluate resume",
        'dict is missing required key(s): "from_update", "versions"',
    ),
    "an override of a wrong type": (
        lambda f: edit(f, lambda d: d["simulation"]["overrides"].update(reynolds="abc")),
        "evaluate resume replay",
        "its overrides have a value of another type",
    ),
    "a simulation of no kind": (
        lambda f: edit(f, lambda d: d["simulation"].pop("kind")),
        "evaluate",
        'missing required key(s): "kind"',
    ),
    "another Reynolds number written in": (
        lambda f: edit(f, lambda d: d["simulation"]["overrides"].update(reynolds=60.0)),
        "evaluate resume replay",
        "the case of 'cylinder-jets' are not those that",
    ),
    "hashes of other operators": (
        lambda f: edit(f, lambda d: d["kept"].update(operators=["0" * 64])),
        "evaluate resume replay",
        "the operators in",
    ),
    "operators cut short": (
        lambda f: cut(f / "operators.npz", 0.9),
        "evaluate resume replay",
        "operators.npz is damaged",
    ),
    "operators with a bit turned": (lambda f: flip(f / "operators.npz"), "evaluate", "operators"),
    "no baseline": (lambda f: (f / "baseline.npz").unlink(), "evaluate", "baseline.npz is damaged"),
    "a baseline with a bit turned": (lambda f: flip(f / "baseline.npz"), "evaluate resume", "baseline"),
    "checkpoints cut short": (both_checkpoints(lambda p: cut(p, 0.5)), "evaluate resume", "has no whole checkpoint"),
    "checkpoints with a bit turned": (both_checkpoints(flip), "evaluate resume", "has no whole checkpoint"),
    "no checkpoints": (both_checkpoints(Path.unlink), "evaluate resume", "has no whole checkpoint"),
    "a version cut short": (lambda f: cut(f / "versions" / "000001.npz", 0.5), "replay", "000001.npz is damaged"),
    "no version": (
        lambda f: (f / "versions" / "000001.npz").unlink(),
        "replay",
        "version: got 1, wanted one of those in",
    ),
    "episodes without those of an update": (
        lambda f: cut(f / "episodes.csv", 0.6),
        "resume",
        "whole rows of updates 0 to 2, wanted 6; bring them back, or delete the file to go on without them",
    ),
    "updates without one": (
        lambda f: cut(f / "updates.csv", 0.7),
        "resume",
        "whole rows of updates 0 to 2, wanted 3; bring them back",
    ),
    "episodes with a word for a number": (
        lambda f: (f / "episodes.csv").write_text((f / "episodes.csv").read_text().replace("0,", "much,", 1)),
        "evaluate",
        "episodes.csv is damaged (could not convert string to float: 'much')",
    ),
}


def content(folder: Path) -> dict[Path, bytes]:
    """Return all that a folder holds, but for pictures and what an evaluation writes."""
    made = ("evaluation.json", "wake.png", "learning-curve.png")
    return {path: path.read_bytes() for path in paths(folder) if path.is_file() and path.name not in made}


@pytest.mark.parametrize("name", DAMAGES)
def test_a_damaged_folder_is_refused_and_left_as_it_is(command, whole, tmp_path, name):
    damage, commands, message = DAMAGES[name]
    for word in commands.split():
        folder = tmp_path / word
        shutil.copytree(whole, folder)
        damage(folder)
        before = content(folder)
        status, printed = command(word, folder, *(["3"] if word == "replay" else []))
        assert message in printed, word
        assert (status, "Traceback" in printed) == (2, False), word
        assert content(folder) == before, word


def with_a_trap_in(path: Path, trap: Trap) -> None:
    """Put a trap into every part of a file of arrays, or of a checkpoint, in pickles."""
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
    with zipfile.ZipFile(path, "w") as archive:
        for name in names:
            buffer = io.BytesIO()
            if name.endswith(".npy"):
                np.save(buffer, np.array([trap], dtype=object), allow_pickle=True)
            else:
                pickle.dump(trap, buffer, protocol=2)
            archive.writestr(name, buffer.getvalue())


HOSTILE = {
    "baseline.npz": "evaluate resume replay",
    "operators.npz": "evaluate resume replay",
    "versions/000001.npz": "replay",
    "checkpoints/last.zip": "evaluate resume",
    "checkpoints/best.zip": "evaluate",
}


@pytest.mark.parametrize("name", HOSTILE)
def test_code_in_a_file_of_a_run_folder_is_never_run(command, whole, tmp_path, name):
    for word in HOSTILE[name].split():
        folder, sprung = tmp_path / word, tmp_path / "sprung"
        shutil.copytree(whole, folder)
        with_a_trap_in(folder / name, Trap(sprung))
        if name.startswith("checkpoints"):
            shutil.copy(folder / name, folder / "checkpoints" / "previous.zip")
        also = ["3"] if word == "replay" else ["--checkpoint", "best"] if "best" in name else []
        status, printed = command(word, folder, *also)
        assert not sprung.exists(), word
        assert status == 2, word
        assert "damaged" in printed or "no whole checkpoint" in printed, word


def rest(data: dict, names: dict) -> dict:
    """Return the parts of a simulation that names lack, where they are of a flow."""
    return {} if "kind" in names else {key: part for key, part in data["simulation"].items() if key not in names}


def test_no_module_and_no_file_that_a_folder_names_is_imported(command, whole, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for word in ("evaluate", "resume", "replay"):
        folder, sprung = tmp_path / word, tmp_path / "sprung"
        shutil.copytree(whole, folder)
        evil = f"import os\nos.mkdir({str(sprung)!r})\n"
        for where in (folder, tmp_path):
            (where / "evil.py").write_text(evil)
        (folder / "case.py").write_text(evil)
        also = ["3"] if word == "replay" else []
        for names, message in (
            ({"kind": "env", "env": "evil:make", "folder": str(folder), "horizon": 2}, "no module is imported because"),
            ({"shipped": False, "file": str(folder / "case.py"), "file_sha256": "0"}, "not run because a folder names"),
            ({"name": "evil", "file": "evil.py"}, "not run because a folder names it"),
        ):
            edit(folder, lambda data, names=names: data.update(simulation=names | rest(data, names)))
            status, printed = command(word, folder, *also)
            assert (status, sprung.exists()) == (2, False), word
            assert message in printed, word
            shutil.copy(whole / "settings.json", folder / "settings.json")


def test_a_loaded_policy_is_that_of_the_run_and_runs_no_code(whole, tmp_path):
    seen = np.random.default_rng(0).normal(size=(5, 151))
    ours = load_policy(whole)
    theirs = PPO.load(whole / "checkpoints" / "last.zip", device="cpu").predict(seen, deterministic=True)[0]
    np.testing.assert_allclose(ours(seen), theirs, atol=1e-5)
    np.testing.assert_array_equal(ours(seen[2]), ours(seen)[2])
    for path in (whole / "versions" / "000003.npz", whole / "checkpoints" / "last.zip"):
        np.testing.assert_array_equal(load_policy(path)(seen), ours(seen))
    with pytest.raises(ValueError, match=r"observation: got shape \(5,\), wanted \(151,\)"):
        ours(seen[:, 0])
    for name, message in (("versions/000003.npz", "is damaged"), ("checkpoints/last.zip", "is damaged")):
        path = tmp_path / Path(name).name
        shutil.copy(whole / name, path)
        with_a_trap_in(path, Trap(tmp_path / "sprung"))
        with pytest.raises(ValueError, match=message):
            load_policy(path)
    assert not (tmp_path / "sprung").exists()


def test_a_damaged_last_checkpoint_is_passed_over_for_the_one_before_and_that_is_said(command, whole, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(whole, folder)
    cut(folder / "checkpoints" / "last.zip", 0.5)
    status, printed = command("evaluate", folder)
    assert status == 0
    assert "last.zip is not whole; previous.zip was taken" in printed


def test_a_damaged_best_checkpoint_is_named(command, whole, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(whole, folder)
    flip(folder / "checkpoints" / "best.zip")
    status, printed = command("evaluate", folder, "--checkpoint", "best")
    assert (status, "best.zip is damaged" in printed) == (2, True)


def test_an_evaluation_that_cannot_be_kept_is_shown_all_the_same(command, whole, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(whole, folder)
    (folder / "evaluation.json").unlink()
    (folder / "evaluation.json").mkdir()  # as on a folder that is read only: it cannot be written
    status, printed = command("evaluate", folder, "--json")
    assert status == 2
    assert "drag reduction" in printed and '"drag_reduction"' in printed and "evaluation.json" in printed


def test_a_run_before_its_first_update_is_evaluated(command, whole, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(whole, folder)
    (folder / "episodes.csv").write_text((folder / "episodes.csv").read_text().splitlines()[0] + "\n")
    assert command("evaluate", folder)[0] == 0


def test_tables_that_were_deleted_are_begun_anew_and_gone_on_with_twice(command, whole, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(whole, folder)
    (folder / "episodes.csv").unlink()
    assert command("resume", folder)[0] == 0
    assert command("resume", folder)[0] == 0


def test_versions_that_changed_are_said_and_recorded_when_a_run_goes_on(command, whole, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(whole, folder)
    edit(folder, lambda data: data["versions"].update(numpy="1.0"))
    for times in (1, 2):
        status, printed = command("resume", folder)
        assert status == 0
        assert (f"numpy 1.0 is {np.__version__} now" in printed) is (times == 1)
        data = json.loads((folder / "settings.json").read_text())
        assert data["versions"]["numpy"] == "1.0"
        assert [(part["from_update"], part["versions"]["numpy"]) for part in data["later"]] == [(3, np.__version__)]


def test_a_folder_is_named_as_it_is_whatever_brackets_it_has(command, tmp_path):
    status, printed = command("evaluate", tmp_path / "[bold]x[/red]")
    assert (status, "[bold]x[/red]" in printed) == (2, True)
