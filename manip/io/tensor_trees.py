"""Trees of values as files that never run code when loaded.

A tree (nested dicts and lists of tensors, arrays, numbers and strings) becomes one
safetensors file with a checksum: tensors in the body, all else as JSON in the header.
Tensors of any device are read as tensors of the CPU.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError, safe_open

from manip.errors import DamagedError, UserError, one_line
from manip.io.checksums import save_with_checksum, verify_checksum

_TENSOR, _ARRAY, _INT_KEYS = "$tensor", "$array", "$int_keys"

_READ_ERRORS = (
    *(SafetensorError, RecursionError),
    *(AttributeError, KeyError, TypeError, ValueError),
)
"""What reading raises where a file is not what `save_tree` wrote."""


def save_tree(path: Path, tree: Any) -> None:
    """Write a tree to one safetensors file, atomically.

    Raises:
        TypeError: a dict has keys of two types, or a leaf cannot be stored.
    """
    tensors: dict[str, torch.Tensor] = {}
    header = json.dumps(_flatten(tree, "", tensors))
    save_with_checksum(path, tensors, {"tree": header})


def load_tree(path: Path) -> Any:
    """Read what `save_tree` wrote.

    Raises:
        UserError: there is no such file.
        DamagedError: it was changed since it was written, or is of another kind.
    """
    if not path.is_file():
        raise UserError(f"there is no file {path}")
    try:
        verify_checksum(path)
        with safe_open(path, "pt") as file:
            header = json.loads((file.metadata() or {})["tree"])
            return _Tensors(file).unflatten(header)
    except _READ_ERRORS as error:
        raise DamagedError(
            f"{path} is damaged or not a manip file: {one_line(error)}"
        ) from error


def _flatten(node: Any, path: str, tensors: dict[str, torch.Tensor]) -> Any:
    """The tree with names in place of tensors, which go to `tensors`."""
    if isinstance(node, torch.Tensor):
        name = _unused(path, tensors)
        tensors[name] = node.detach().cpu().contiguous().clone()
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


class _Tensors:
    """The tensors of an open file, each of which a tree may name once.

    A small file could name one tensor many times and fill the memory with its copies.
    """

    def __init__(self, file: Any) -> None:
        self._file, self._unread = file, set(file.keys())

    def unflatten(self, node: Any) -> Any:
        """The tree with tensors in place of their names."""
        if isinstance(node, list):
            return [self.unflatten(child) for child in node]
        if not isinstance(node, dict):
            return node
        if _TENSOR in node:
            return self._read(node[_TENSOR])
        if _ARRAY in node:
            return self._read(node[_ARRAY]).numpy()
        if _INT_KEYS in node:
            children = node[_INT_KEYS].items()
            return {int(key): self.unflatten(child) for key, child in children}
        return {key: self.unflatten(child) for key, child in node.items()}

    def _read(self, name: str) -> torch.Tensor:
        self._unread.remove(name)
        tensor: torch.Tensor = self._file.get_tensor(name)
        return tensor
