"""The commands as users type them."""

import json
import signal
import subprocess
import sys
import time

import pytest

pytestmark = pytest.mark.alone

TINY = ["--episodes", "2", "--update-period", "2", "--actions", "2", "--hidden", "8"]


def manywake(*words: str) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, "-m", "manywake.cli", *words], capture_output=True, text=True, check=False)


def test_train_evaluates_and_leaves_the_promised_files(tmp_path):
    folder = tmp_path / "run"
    done = manywake("train", "--run", str(folder), "--json", *TINY)
    assert done.returncode == 0, done.stderr
    numbers = json.loads(done.stdout.splitlines()[-1])
    one = {
        "cd_uncontrolled",
        "cd_controlled",
        "drag_reduction",
        "net_reduction",
        "share_of_shedding_drag",
        "cl_mean",
        "cl_rms",
        "cl_std",
        "amplitude_rms",
        "power",
        "reward",
    }
    assert one <= set(numbers) and one <= set(numbers["long_run"])
    assert {"wall_time_s", "episodes", "policy_sha256"} <= set(numbers)
    files = {path.name for path in folder.rglob("*")}
    expected = {"settings.json", "episodes.csv", "last.zip", "best.zip", "learning-curve.png", "wake.png"}
    assert expected <= files
    again = manywake("evaluate", str(folder), "--json")
    assert again.returncode == 0, again.stderr
    assert json.loads(again.stdout.splitlines()[-1])["long_run"] == numbers["long_run"]
    done = manywake("replay", str(folder), "1", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1])["same_as_recorded"] is True


def test_a_training_stopped_by_ctrl_c_says_how_to_resume_and_resumes(tmp_path):
    folder = tmp_path / "run"
    words = ["train", "--run", str(folder), "--env", "Pendulum-v1", "--episodes", "8", "--update-period", "2"]
    words += ["--actions", "200", "--hidden", "8"]
    command = [sys.executable, "-m", "manywake.cli", *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as trainer:
        while not (folder / "updates.csv").exists() and trainer.poll() is None:
            time.sleep(0.005)
        trainer.send_signal(signal.SIGINT)
        text = trainer.communicate()[0]
    assert trainer.returncode == 130, text
    assert f"go on with: manywake resume {folder}" in " ".join(text.split())
    done = manywake("resume", str(folder), "--json", "--engine", "serial")
    assert done.returncode == 2  # what a folder names is not imported unasked
    assert "give it again: --env Pendulum-v1" in done.stderr
    done = manywake("resume", str(folder), "--json", "--engine", "serial", "--env", "Pendulum-v1")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1])["episodes"] == 8


def test_an_evaluation_stopped_by_ctrl_c_does_not_play_to_its_end(tmp_path):
    (tmp_path / "mine.py").write_text(
        "from pathlib import Path\n\n\ndef still(observation, info):\n    Path('plays').touch()\n    return [0.0]\n"
    )
    words = [sys.executable, "-m", "manywake.cli", "evaluate", "--controller", "mine:still", "--actions", "1000000"]
    with subprocess.Popen(words, cwd=tmp_path, stderr=subprocess.PIPE, text=True) as process:
        while not (tmp_path / "plays").exists() and process.poll() is None:
            time.sleep(0.005)
        process.send_signal(signal.SIGINT)
        text = process.communicate(timeout=60)[1]
    assert process.returncode == 130, text
    assert text.split()[-1] == "stopped"


def test_protocol_sets_the_defaults_that_options_then_override(tmp_path):
    done = manywake("train", "--protocol", "paper", "--run", str(tmp_path / "run"), *TINY)
    assert done.returncode == 0, done.stderr
    settings = json.loads((tmp_path / "run" / "settings.json").read_text())
    assert settings["format"] == 3
    assert settings["simulation"]["protocol"] == "paper"
    assert settings["simulation"]["overrides"] == {"actions": 2}
    assert settings["simulation"]["task"]["reward"]["name"] == "paper"
    assert settings["simulation"]["task"]["actions"] == 2
    assert settings["learning"]["learning_rate_end"] == 1e-3


def test_a_mesh_is_drawn_without_a_baseline(tmp_path):
    done = manywake("mesh", "--case", "pinball", "-o", str(tmp_path / "mesh.png"), "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert (found["triangles"], found["time step"]) == (3352, 0.0025)
    assert (tmp_path / "mesh.png").read_bytes().startswith(b"\x89PNG")


def test_baseline_describes_the_shipped_case():
    done = manywake("baseline", "--json")
    assert done.returncode == 0, done.stderr
    numbers = json.loads(done.stdout.splitlines()[-1])
    assert numbers["c_d mean"] == pytest.approx(3.1959, rel=5e-3)
    assert numbers["c_d steady"] == pytest.approx(2.942, rel=5e-3)
    assert numbers["St"] == pytest.approx(0.3018, rel=5e-3)
    assert (numbers["kind"], numbers["start states"]) == ("periodic", 4)
    assert numbers["cylinder.top withstood, held"] == numbers["cylinder.top withstood, smooth"] == 0.01


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["train", "--case", "sphere"], "case: got 'sphere', wanted one of"),
        (["train", "--reward", "lift"], "reward: got 'lift', wanted one of"),
        (["train", "--interval", "0.0252"], "wanted a multiple of the time step"),
        (["train", "--episodes", "7"], "wanted a multiple of the update period"),
        (["evaluate", "nowhere"], "has no settings.json"),
    ],
)
def test_bad_settings_are_one_clear_line(words, text):
    done = manywake(*words)
    assert done.returncode == 2
    assert text in " ".join((done.stderr + done.stdout).replace("│", " ").split())
    assert "Traceback" not in done.stderr


MINE = """from manywake.suite.cylinder_jets import CASE, TASK, replace

TASK = replace(TASK, reward=lambda now, free: free["c_d"] - now["c_d"], actions=2)
REWARDS = {"mine": TASK.reward, "lift": lambda now, free: -abs(now["c_l"])}
"""


def test_a_run_of_a_user_s_own_file_wants_that_very_file_again(tmp_path):
    path, folder = tmp_path / "mine.py", tmp_path / "run"
    path.write_text(MINE)
    words = ["--episodes", "2", "--update-period", "2", "--hidden", "8", "--reward", "lift", "--limit", "0.005"]
    done = manywake("train", "--case", str(path), "--run", str(folder), "--json", *words)
    assert done.returncode == 0, done.stderr
    assert (folder / "case.py").read_text() == MINE
    described = json.loads((folder / "settings.json").read_text())["simulation"]
    assert (described["name"], described["shipped"]) == ("mine", False)
    assert described["overrides"] == {"reward": "lift", "limit": 0.005}
    assert [actuator["limit"] for actuator in described["case"]["actuators"]] == [0.005, 0.005]
    done = manywake("replay", str(folder), "1", "--case", str(path), "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1])["same_as_recorded"] is True
    path.write_text(MINE + "# another\n")
    done = manywake("replay", str(folder), "1", "--case", str(path))
    assert done.returncode == 2
    assert "is not the file that" in done.stderr and "Traceback" not in done.stderr


def test_the_help_has_the_options_of_the_case_that_the_words_name():
    done = manywake("train", "--help", "--case", "cylinder-jets-goda")
    assert done.returncode == 0
    text = " ".join(done.stdout.replace("│", " ").split())
    assert "--time-step FLOAT" in text and "(default: 0.0005)" in text
    for option in ("--limit.cylinder.top", "--points.pressure", "--sizes.body", "--law.alpha", "--observe", "--reward"):
        assert option in text
    done = manywake("baseline", "--help")
    text = " ".join(done.stdout.split())
    assert "--reynolds" in text and "--reward" not in text and "--law" not in text  # they change nothing of the flow


def test_a_case_without_a_task_has_a_baseline_and_cannot_be_trained(tmp_path):
    path = tmp_path / "flow.py"
    path.write_text("from manywake.suite.cylinder_jets import CASE\n")
    done = manywake("baseline", "--case", str(path), "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1])["kind"] == "periodic"
    done = manywake("train", "--case", str(path))
    assert done.returncode == 2
    assert "task: got none" in done.stderr and "Traceback" not in done.stderr
