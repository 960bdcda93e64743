"""The network of an exported policy: .onnx by onnxruntime, .npz by numpy alone."""

import json
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

Array = np.ndarray


def network_action(card: Mapping[str, Any], w: Mapping[str, Array], x: Array) -> Array:
    """Actions [N, A] of a policy that sees the state, from observations x [N, D].

    The card's `network` says how: y = clip((x - mean) / sqrt(var + epsilon)), linear
    layers with an activation between them, and the head.
    """
    net, actions = card["network"], card["action_dim"]
    if net["normaliser"]:
        low, high = net["normaliser"]["clip"]
        spread = np.sqrt(w["norm.var"] + net["normaliser"]["epsilon"])
        x = np.clip((x - w["norm.mean"]) / spread, low, high)
    for layer in net["layers"]:
        if layer["kind"] == "linear":
            x = x @ w[layer["name"] + ".weight"].T + w[layer["name"] + ".bias"]
        elif layer["kind"] == "layer_norm":
            x = x - x.mean(-1, keepdims=True)
            x = x / np.sqrt((x * x).mean(-1, keepdims=True) + layer["epsilon"])
            x = x * w[layer["name"] + ".weight"] + w[layer["name"] + ".bias"]
        else:
            x = np.maximum(x, 0) if layer["kind"] == "relu" else np.tanh(x)
    scale = w["action_scale"]
    if net["head"] == "best bin":
        values = x[:, 1:].reshape(len(x), actions, net["bins"])
        return scale * (2 * values.argmax(-1) / (net["bins"] - 1) - 1)
    mean = x[:, :actions]
    return (
        scale * np.tanh(mean) if net["head"] == "tanh" else np.clip(scale * mean, -1, 1)
    )


def open_policy(path: str) -> tuple[dict[str, Any], Callable[..., Array]]:
    """The card of an exported policy, and its function.

    Args:
        path: a file of `manip export` that ends with .onnx or .npz.

    Returns:
        The card, and a function of the joined observation [N, D] float32 and the image
        [N, H, W, C] uint8 of each camera, which returns the action [N, A].

    Raises:
        ValueError: the path ends otherwise.
        OSError: there is no such file.
    """
    if not path.endswith((".npz", ".onnx")):
        raise ValueError(f"{path} must be an .onnx or .npz file of `manip export`")
    if path.endswith(".npz"):
        with np.load(path, allow_pickle=False) as file:
            card = json.loads(str(file["card"]))
            names = [name for name in file.files if name != "card"]
            weights = {name: file[name].astype(np.float64) for name in names}
        return card, lambda *inputs: network_action(card, weights, inputs[0])
    import onnxruntime

    with open(path, "rb"):  # onnxruntime has no OSError of its own
        pass
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    names = [entry.name for entry in session.get_inputs()]

    def run(*inputs: Array) -> Array:
        action: Array = session.run(None, dict(zip(names, inputs, strict=True)))[0]
        return action

    return json.loads(session.get_modelmeta().custom_metadata_map["manip"]), run
