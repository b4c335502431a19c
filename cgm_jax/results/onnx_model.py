"""A policy file as an ONNX model: what other runtimes, on robots and in browsers, load."""

# onnx comes with an extra, and its stubs are incomplete.
# pyright: reportMissingImports=false

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from cgm_jax.storage.policies import layer_count

if TYPE_CHECKING:
    import onnx

Node = tuple[str, list[str], str, dict[str, int]]
"""An operator: its kind, inputs and output by name, and attributes."""

OPSET, IR_VERSION = 17, 8
"""Old enough for every runtime in use (ONNX 1.12, 2022), new enough for all that is needed."""


def onnx_model(arrays: Mapping[str, np.ndarray]) -> "onnx.ModelProto":
    """The model of a policy: `observation` [batch, o] and `goal` [batch, n] to `action` [batch, a].

    Normalisation is part of it, and the batch may be of any size. All is float32. It serves the
    full goal: what a policy sees of masks is 0 then.

    Args:
        arrays: as `storage.policies.load_policy` returns them.

    Raises:
        ImportError: the package onnx is not installed.
    """
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    nodes = [
        helper.make_node(kind, inputs, [output], **attributes)
        for kind, inputs, output, attributes in _nodes(arrays)
    ]
    layers = layer_count(arrays)
    sizes = {
        "observation": arrays["observation_mean"].size,
        "goal": arrays["goal_mean"].size,
        "action": arrays[f"layer_{layers - 1}_bias"].size,
    }
    observation, goal, action = (
        helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", size])
        for name, size in sizes.items()
    )
    constants = {name: value for name, value in arrays.items() if name != "mask_weights"}
    for name in ("normalised_limit", "raw_limit"):
        if name in arrays:
            constants[f"minus_{name}"] = -arrays[name]
    graph = helper.make_graph(
        nodes,
        "policy",
        [observation, goal],
        [action],
        [numpy_helper.from_array(np.asarray(value), name) for name, value in constants.items()],
    )
    model = helper.make_model(
        graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION
    )
    onnx.checker.check_model(model, full_check=True)
    return model


def _nodes(
    arrays: Mapping[str, np.ndarray],
) -> Iterator[Node]:
    """The operators in order: the same steps as `storage.policies.act`."""
    for kind in ("observation", "goal"):
        value = kind
        if "raw_limit" in arrays:  # of policy files of the first format
            value = f"{kind}_clipped"
            yield "Clip", [kind, "minus_raw_limit", "raw_limit"], value, {}
        yield "Sub", [value, f"{kind}_mean"], f"{kind}_centred", {}
        yield "Div", [f"{kind}_centred", f"{kind}_std"], f"{kind}_scaled", {}
    yield "Concat", ["observation_scaled", "goal_scaled"], "scaled", {"axis": 1}
    yield "Clip", ["scaled", "minus_normalised_limit", "normalised_limit"], "inputs", {}
    value, layers = "inputs", layer_count(arrays)
    for i in range(layers):
        yield "Gemm", [value, f"layer_{i}_kernel", f"layer_{i}_bias"], f"layer_{i}", {}
        value = f"layer_{i}_active" if i < layers - 1 else "action"
        yield "Relu" if i < layers - 1 else "Tanh", [f"layer_{i}"], value, {}
