"""A run's policy as an ONNX graph: normalise, clip, dense layers with ReLU, mean action, clip.

The graph is in single precision: its actions are those of `Policy` to about 1e-6.
"""

import json
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from manywake.learn import external, flows
from manywake.learn.policy import NORMALISED_LIMIT, Policy
from manywake.learn.runs import Run, checked
from manywake.machine import disk

OPSET, FORMAT = 17, 8
"""Versions of the operators and of the file: of 2022, so that runtimes that are not new read it too."""
INPUT, OUTPUT = "observation", "action"


def _onnx() -> Any:
    try:
        import onnx
    except ImportError as error:
        raise RuntimeError(
            f"onnx: cannot be loaded ({error}), wanted it to write a policy's graph; "
            "install it with: pip install 'manywake[onnx]'"
        ) from error
    return onnx


def describe(run: Run) -> dict[str, str]:
    """Return what a run's policy is told and what its actions do, as text by name, for a model's metadata.

    Nothing that the run names is opened. ValueError when the folder is no run, or damaged.
    """
    said, about = run.described()["simulation"], {"manywake": version("manywake")}
    if said.get("kind") == external.KIND:
        named = checked(said, external.Described, run.path)["env"]
        return about | {"env": named, OUTPUT: "the mean action; clip it to the environment's action space"}
    flow = checked(said, flows.Described, run.path)
    try:
        return about | _of_flow(flow["name"], flow["protocol"], flow["case"], flow["task"])
    except (KeyError, TypeError) as error:
        raise ValueError(f"run: {run.path} is damaged, or of another version ({error!r})") from error


def _of_flow(name: str, protocol: str, case: dict[str, Any], task: dict[str, Any]) -> dict[str, str]:
    sensors = {sensor["name"]: sensor for sensor in case["sensors"]}
    observed = [sensors.get(each, {"name": each}) for each in task["observe"]]
    inputs = [{key: each[key] for key in ("kind", "on", "limit")} for each in case["actuators"]]
    about = {
        "reynolds": task["reynolds_numbers"] or case["reynolds"],
        "scales": {key: case["scales"][key] for key in ("length", "velocity")},
        INPUT: {"history": task["history"], "observe": observed},
        "limits": inputs,
        **{key: task[key] for key in ("interval", "delay", "law", "mixing")},
    }
    actions = "in [-1, 1]; mixing, its rows scaled to absolute sums of at most 1, gives inputs in units of their limits"
    return {"case": name, "protocol": protocol, OUTPUT: actions} | {key: json.dumps(x) for key, x in about.items()}


def build(policy: Policy, about: dict[str, str], limit: float | None = 1.0) -> Any:
    """Return a policy's graph: "observation" (batch, values) -> "action" (batch, actions), both float32.

    about: metadata. limit: the mean action is clipped to +- this, or not at all. RuntimeError without onnx.
    """
    onnx = _onnx()
    helper, name = onnx.helper, INPUT
    constants: list[Any] = []
    nodes: list[Any] = []

    def constant(called: str, value: Any) -> str:
        constants.append(onnx.numpy_helper.from_array(np.ascontiguousarray(value, np.float32), called))
        return called

    def apply(kind: str, *others: str, to: str = "", **options: Any) -> None:
        nonlocal name
        after = to or f"{kind.lower()}{len(nodes)}"
        nodes.append(helper.make_node(kind, [name, *others], [after], **options))
        name = after

    # where a value hardly varies about its mean, the mean's rounding shows: it is taken off in two parts
    high = policy.mean.astype(np.float32)
    apply("Sub", constant("mean", high))
    apply("Sub", constant("mean_rest", policy.mean - high))
    apply("Div", constant("deviation", policy.deviation))
    apply("Clip", constant("least", -NORMALISED_LIMIT), constant("most", NORMALISED_LIMIT))
    for k, (weight, bias) in enumerate(policy.layers):
        last = k == len(policy.layers) - 1
        to = OUTPUT if last and limit is None else ""
        apply("Gemm", constant(f"weight{k}", weight), constant(f"bias{k}", bias), to=to, transB=1)
        if not last:
            apply("Relu")
    if limit is not None:
        apply("Clip", constant("action_least", -limit), constant("action_most", limit), to=OUTPUT)

    def value(called: str, size: int) -> Any:
        return helper.make_tensor_value_info(called, onnx.TensorProto.FLOAT, ["batch", size])

    ends = [value(INPUT, len(policy.mean))], [value(OUTPUT, len(policy.layers[-1][1]))]
    graph = helper.make_graph(nodes, "policy", *ends, constants)
    model = helper.make_model(
        graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=FORMAT, producer_name="manywake"
    )
    helper.set_model_props(model, about | {"policy_version": str(policy.version)})
    onnx.checker.check_model(model)
    return model


def write(run: Run, path: Path) -> Policy:
    """Write the newest policy of a run to a file, and return it."""
    policy, about = run.newest_version(), describe(run)
    model = build(policy, about, 1.0 if "case" in about else None)
    disk.write(path, lambda file: file.write(model.SerializeToString()))
    return policy
