"""Arrays of numpy or torch: what code needs that computes with either.

Tasks compute with numpy on the host, and some of them with torch on the device of the
physics. numpy and torch have most functions under the same name, with `axis`.
"""

import sys
from collections.abc import Mapping
from typing import Any

import numpy as np

Array = np.ndarray


def is_tensor(values: Any) -> bool:
    """Whether it is a torch tensor; does not import torch."""
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(values, torch.Tensor)


def namespace(values: Any) -> Any:
    """The module whose functions take these values: torch for its tensors, or numpy."""
    return sys.modules["torch"] if is_tensor(values) else np


def constant(values: Any, like: Any) -> Any:
    """Numbers for arithmetic with an array: a tensor on its device if it is one."""
    if is_tensor(values) or not is_tensor(like):
        return values
    return namespace(like).as_tensor(np.asarray(values), device=like.device)


def floats(flags: Any) -> Any:
    """Flags as numbers, 0.0 or 1.0, in float64."""
    return flags.double() if is_tensor(flags) else flags.astype(float)


def on_host(values: Any) -> Array:
    """A numpy array of an array or tensor; the same memory if that is the host's."""
    array: Array = values.numpy(force=True) if is_tensor(values) else values
    return array


def all_on_host(named: Mapping[str, Any]) -> dict[str, Array]:
    """The same for named arrays or tensors."""
    return {name: on_host(values) for name, values in named.items()}
