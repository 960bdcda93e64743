"""Actions of a policy from the two files of its folder, with numpy and json alone."""

import json
import sys
from pathlib import Path

import numpy as np


def read_safetensors(path: Path) -> dict[str, np.ndarray]:
    """Name -> array float64: a header's length, the header as JSON, then the arrays."""
    data = path.read_bytes()
    start = 8 + int.from_bytes(data[:8], "little")
    header = json.loads(data[8:start])
    arrays = {}
    for name, entry in header.items():
        if entry.get("dtype") == "F32" and name.startswith("weights/"):
            begin, end = (start + offset for offset in entry["data_offsets"])
            values = np.frombuffer(data[begin:end], "<f4").astype(np.float64)
            arrays[name.removeprefix("weights/")] = values.reshape(entry["shape"])
    return arrays


def act(folder: Path, x: np.ndarray) -> np.ndarray:
    """Actions [N, A] for observations x [N, D], the card's parts joined in order."""
    card = json.loads((folder / "policy.json").read_text())
    w, network = read_safetensors(folder / "policy.safetensors"), card["network"]
    if norm := network["normaliser"]:
        x = (x - w["norm.mean"]) / np.sqrt(w["norm.var"] + norm["epsilon"])
        x = np.clip(x, *norm["clip"])
    for layer in network["layers"]:
        weight, bias = (w.get(f"{layer.get('name')}.{k}") for k in ("weight", "bias"))
        match layer["kind"]:
            case "linear":
                x = x @ weight.T + bias
            case "layer_norm":
                spread = np.sqrt(x.var(-1, keepdims=True) + layer["epsilon"])
                x = (x - x.mean(-1, keepdims=True)) / spread * weight + bias
            case "relu":
                x = np.maximum(x, 0)
            case "tanh":
                x = np.tanh(x)
    scale, mean = w[network["action_scale"]], x[:, : card["action_dim"]]
    match network["head"]:
        case "tanh":
            return scale * np.tanh(mean)
        case "clip":
            return np.clip(scale * mean, -1, 1)
        case "best bin":
            bins = network["bins"]
            best = x[:, 1:].reshape(len(x), -1, bins).argmax(-1)
            return scale * (2 * best / (bins - 1) - 1)


if __name__ == "__main__":
    print(act(Path(sys.argv[1]), np.loadtxt(sys.stdin, ndmin=2)))
