"""Trees as files that never run code when loaded.

A tree (nested dicts and lists of tensors, arrays, numbers and strings) becomes one
sealed safetensors file: tensors in the body, everything else as JSON in the header.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError, safe_open

from manip.errors import DamagedError, UserError, one_line
from manip.io.checksums import check_seal, save_sealed

_TENSOR, _ARRAY, _INT_KEYS = "$tensor", "$array", "$int_keys"

_REFUSALS = (
    *(SafetensorError, RecursionError),
    *(AttributeError, KeyError, TypeError, ValueError),
)
"""What reading a file raises that is not what it should be."""


def save_tree(path: Path, tree: Any) -> None:
    """Write a tree to one safetensors file, whole or not at all."""
    tensors: dict[str, torch.Tensor] = {}
    header = json.dumps(_flatten(tree, "", tensors))
    save_sealed(path, tensors, {"tree": header})


def load_tree(path: Path) -> Any:
    """Read what `save_tree` wrote.

    Raises:
        UserError: there is no such file.
        DamagedError: it was changed since it was written, or is of another kind.
    """
    if not path.is_file():
        raise UserError(f"there is no {path}")
    try:
        check_seal(path)
        with safe_open(path, "pt") as file:
            header = json.loads((file.metadata() or {})["tree"])
            return _unflatten(header, file)
    except _REFUSALS as error:
        reason = one_line(error)
        raise DamagedError(
            f"{path} is damaged or not a manip file: {reason}"
        ) from error


def _flatten(node: Any, path: str, tensors: dict[str, torch.Tensor]) -> Any:
    if isinstance(node, torch.Tensor):
        name = _unused(path, tensors)
        tensors[name] = node.detach().contiguous().clone()
        return {_TENSOR: name}
    if isinstance(node, np.ndarray):
        name = _unused(path, tensors)
        tensors[name] = torch.from_numpy(node.copy(order="C"))
        return {_ARRAY: name}
    if isinstance(node, dict):
        int_keys = _has_int_keys(node)
        children = {
            str(key): _flatten(child, f"{path}/{key}", tensors)
            for key, child in node.items()
        }
        return {_INT_KEYS: children} if int_keys else children
    if isinstance(node, list | tuple):
        return [_flatten(child, f"{path}/{i}", tensors) for i, child in enumerate(node)]
    return node


def _unused(path: str, tensors: dict[str, torch.Tensor]) -> str:
    """A tensor's path in the tree, unless another has it: {"a/b"} and {"a": {"b"}}."""
    name = path[1:]
    return f"{name}#{len(tensors)}" if name in tensors else name


def _has_int_keys(node: dict[Any, Any]) -> bool:
    kinds = {type(key) for key in node}
    if not kinds <= {int} and not kinds <= {str}:
        raise TypeError(f"keys must be all text or all integers, not {list(node)}")
    return kinds == {int}


def _unflatten(node: Any, file: Any) -> Any:
    if isinstance(node, list):
        return [_unflatten(child, file) for child in node]
    if not isinstance(node, dict):
        return node
    if _TENSOR in node:
        return file.get_tensor(node[_TENSOR])
    if _ARRAY in node:
        return file.get_tensor(node[_ARRAY]).numpy()
    if _INT_KEYS in node:
        return {int(k): _unflatten(v, file) for k, v in node[_INT_KEYS].items()}
    return {key: _unflatten(child, file) for key, child in node.items()}
