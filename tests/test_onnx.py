"""A policy's graph against the policy, by another runtime."""

import json
import subprocess
import sys

import numpy as np
import onnx
import onnxruntime
import pytest

import manywake
from manywake.learn import onnx as graphs
from manywake.learn import policy as policies
from manywake.learn.policy import Policy
from manywake.learn.runs import Run

HERE = manywake.Collection(engine="serial")


def random_policy(values: int, *sizes: int, seed: int = 0) -> Policy:
    """Return a policy with random weights, of actions that reach past [-1, 1]."""
    random, widths = np.random.default_rng(seed), (values, *sizes)
    layers = tuple(
        (random.normal(0, width**-0.5, (out, width)).astype(np.float32), random.normal(0, 0.1, out).astype(np.float32))
        for width, out in zip(widths[:-1], widths[1:], strict=True)
    )
    mean, deviation = random.normal(1, 2, values), random.uniform(0.1, 2.0, values)
    log_std = np.full(sizes[-1], -0.5)
    return Policy(7, mean, deviation, layers, log_std, np.exp(log_std))


def session(model: bytes) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    return onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])


def theirs(model: bytes, observations: np.ndarray) -> np.ndarray:
    return session(model).run([graphs.OUTPUT], {graphs.INPUT: observations})[0]


@pytest.mark.parametrize("sizes", [(1,), (64, 64, 3), (512, 2)])
@pytest.mark.parametrize("scale", [1.0, 100.0], ids=["in range", "out of range"])
def test_the_graph_gives_the_policy_s_actions_cut_to_their_range(sizes, scale):
    policy = random_policy(151, *sizes)
    seen = (policy.mean + scale * policy.deviation * np.random.default_rng(1).normal(size=(40, 151))).astype(np.float32)
    model = graphs.build(policy, {}).SerializeToString()
    ours = np.clip(policies.act(policy, seen), -1.0, 1.0)
    np.testing.assert_allclose(theirs(model, seen), ours, rtol=0, atol=1e-5)
    assert scale == 1.0 or (abs(ours) == 1.0).any()


def test_values_that_hardly_vary_about_their_mean_are_normalised_as_precisely():
    policy = random_policy(20, 32, 2)
    mean, deviation = np.full(20, np.pi), np.full(20, 1e-4)
    policy = Policy(0, mean, deviation, policy.layers, policy.log_std, policy.std)
    seen = (mean + deviation * np.random.default_rng(2).normal(size=(40, 20))).astype(np.float32)
    model = graphs.build(policy, {}).SerializeToString()
    np.testing.assert_allclose(theirs(model, seen), np.clip(policies.act(policy, seen), -1, 1), rtol=0, atol=1e-5)


def test_any_batch_gives_a_row_of_actions_for_each_observation():
    policy = random_policy(5, 16, 2)
    model = graphs.build(policy, {}).SerializeToString()
    seen = np.random.default_rng(3).normal(size=(9, 5)).astype(np.float32)
    whole = theirs(model, seen)
    assert (whole.shape, whole.dtype) == ((9, 2), np.float32)
    for k in range(9):
        np.testing.assert_allclose(theirs(model, seen[k : k + 1])[0], whole[k], rtol=0, atol=1e-6)
    given, got = session(model).get_inputs()[0], session(model).get_outputs()[0]
    assert (given.name, given.shape, given.type) == ("observation", ["batch", 5], "tensor(float)")
    assert (got.name, got.shape, got.type) == ("action", ["batch", 2], "tensor(float)")


def test_without_onnx_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(RuntimeError, match=r"install it with: pip install 'manywake\[onnx\]'"):
        graphs.build(random_policy(3, 1), {})


# ---- the command


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run of the shipped flow, two short episodes long."""
    given = {"episodes": 2, "update_period": 2, "hidden": (8,), "interval": 0.002, "actions": 2}
    return manywake.train(run=tmp_path_factory.mktemp("runs") / "run", collection=HERE, **given)


def test_the_command_writes_the_run_s_newest_policy_and_says_what_it_is_told(run, tmp_path):
    path = tmp_path / "policy.onnx"
    words = ["export-policy", str(run.folder), "-o", str(path), "--json"]
    done = subprocess.run([sys.executable, "-m", "manywake.cli", *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    numbers = json.loads(done.stdout.splitlines()[-1])
    assert numbers == {"file": str(path), "policy after updates": 1, "observed values": 151, "actions": 1}
    policy = manywake.load_policy(run.folder)
    seen = (policy.mean + policy.deviation * np.random.default_rng(4).normal(size=(20, 151))).astype(np.float32)
    np.testing.assert_allclose(theirs(path.read_bytes(), seen), np.clip(policy(seen), -1, 1), rtol=0, atol=1e-5)
    told = {prop.key: prop.value for prop in onnx.load(path).metadata_props}
    assert (told["case"], told["reynolds"], told["interval"], told["policy_version"]) == (
        "cylinder-jets",
        "100",
        "0.002",
        "1",
    )
    assert json.loads(told["limits"]) == [
        {"kind": "Jet", "on": "cylinder.top", "limit": 0.01},
        {"kind": "Jet", "on": "cylinder.bottom", "limit": 0.01},
    ]
    observed = json.loads(told["observation"])["observe"]
    assert [each["name"] for each in observed] == ["pressure"] and len(observed[0]["points"]) == 151


def test_a_run_of_another_simulation_leaves_its_actions_uncut(tmp_path):
    given = {"episodes": 2, "update_period": 2, "batch_size": 400, "hidden": (8,)}
    run = manywake.train(env="Pendulum-v1", run=tmp_path / "run", collection=HERE, **given)
    policy = graphs.write(run.run, tmp_path / "policy.onnx")
    assert "clip it" in {p.key: p.value for p in onnx.load(tmp_path / "policy.onnx").metadata_props}["action"]
    seen = np.random.default_rng(5).normal(0, 50, (20, 3)).astype(np.float32)
    np.testing.assert_allclose(
        theirs((tmp_path / "policy.onnx").read_bytes(), seen), policies.act(policy, seen), rtol=0, atol=1e-5
    )


def test_what_is_no_run_is_one_clear_line(run, tmp_path):
    with pytest.raises(ValueError, match="wanted a folder made by manywake train"):
        graphs.write(Run(tmp_path), tmp_path / "policy.onnx")
    text = json.loads((run.folder / "settings.json").read_text())
    del text["simulation"]["case"]["actuators"]
    with pytest.raises(ValueError, match="is damaged, or of another version"):
        (tmp_path / "settings.json").write_text(json.dumps(text))
        graphs.describe(Run(tmp_path))
