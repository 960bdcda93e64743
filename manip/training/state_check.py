"""Compare a loaded state with that of a new run: same keys, types, shapes, ranges.

A file with a valid checksum can still hold anything. Shapes that differ would be
broadcast in silence, or read past the end of memory in native code.
"""

import copy
from collections.abc import Collection, Mapping
from math import isfinite
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

Array = np.ndarray

LARGEST_COUNT = 10**15
"""No counter of a run gets this far."""


def check_like(value: Any, expected: Any, name: str) -> None:
    """Compare a tree with an expected one; values may differ, types and shapes not.

    Raises:
        ValueError: something differs, or a number is out of its range.
    """
    if isinstance(expected, Mapping):
        check_keys(value, expected, name)
        for key, child in expected.items():
            check_like(value[key], child, f"{name}/{key}")
    elif isinstance(expected, list | tuple):
        _require(isinstance(value, list | tuple), name, "must be a list")
        _require(len(value) == len(expected), name, f"must have {len(expected)} items")
        for number, item in enumerate(value):
            check_like(item, expected[number], f"{name}/{number}")
    elif isinstance(expected, Tensor | np.ndarray):
        check_array(value, expected, name, tuple(expected.shape))
    else:
        _check_scalar(value, expected, name)


def check_keys(value: Any, expected: Collection[Any], name: str) -> None:
    """Check that a value is a mapping with the expected keys.

    Raises:
        ValueError: it is not.
    """
    _require(isinstance(value, Mapping), name, "must be a mapping")
    differ = ", ".join(sorted(map(str, value.keys() ^ set(expected))))
    _require(not differ, name, f"has other entries: {differ}")


def check_array(value: Any, like: Any, name: str, shape: tuple[int, ...]) -> None:
    """Check type, dtype and shape of an array, and the range of whole numbers.

    Raises:
        ValueError: one of them is wrong.
    """
    _require(type(value) is _plain_type(like), name, "must be an array or tensor")
    _require(value.dtype == like.dtype, name, f"must be {like.dtype}")
    _require(
        tuple(value.shape) == shape,
        name,
        f"must have shape {list(shape)}, not {list(value.shape)}",
    )
    numbers = torch.as_tensor(value)
    if not numbers.is_floating_point() and numbers.numel():
        low, high = int(numbers.min()), int(numbers.max())
        _require(-1 <= low <= high <= LARGEST_COUNT, name, "is out of range")


def check_rows(value: Any, expected: Any, name: str) -> int:
    """Compare stored rows, whose number is free, with others; return the number.

    Raises:
        ValueError: keys, types or widths differ, or the numbers of rows.
    """
    if isinstance(expected, Mapping):
        check_keys(value, expected, name)
        counts = {check_rows(value[k], expected[k], f"{name}/{k}") for k in expected}
        _require(len(counts) == 1, name, "must have equally many rows everywhere")
        return counts.pop()
    _require(hasattr(value, "shape") and value.ndim > 0, name, "must have rows")
    check_array(value, expected, name, (len(value), *expected.shape[1:]))
    return len(value)


def check_finite(tree: Any, expected: Any, name: str) -> None:
    """Check that all tensors of a tree are finite, where the expected ones are.

    Raises:
        ValueError: one is not.
    """
    if isinstance(expected, Mapping):
        for key, child in expected.items():
            check_finite(tree[key], child, f"{name}/{key}")
    elif bool(expected.isfinite().all()):
        _require(bool(tree.isfinite().all()), name, "is not finite")


def check_optimiser(value: Any, optimiser: torch.optim.Optimizer, name: str) -> None:
    """Check an optimiser's state: groups, and the moments of every parameter.

    Raises:
        ValueError: it is of other parameters or another optimiser, or out of range.
    """
    expected = _after_a_step(optimiser)
    check_keys(value, expected, name)
    _check_groups(value["param_groups"], expected["param_groups"], name)
    _require(isinstance(value["state"], Mapping), name, "must be a mapping")
    for number, moments in value["state"].items():
        _require(number in expected["state"], name, f"has no parameter {number}")
        check_like(moments, expected["state"][number], f"{name}/{number}")
        for kind, moment in moments.items():
            _check_moment(moment, f"{name}/{number}/{kind}", kind)


def _after_a_step(optimiser: torch.optim.Optimizer) -> dict[str, Any]:
    """The state of an optimiser of the same kind and parameters that has stepped."""
    twin = copy.deepcopy(optimiser)
    for group in twin.param_groups:
        for parameter in group["params"]:
            parameter.grad = torch.zeros_like(parameter)
    twin.step()
    return twin.state_dict()


def _check_groups(value: Any, expected: list[dict[str, Any]], name: str) -> None:
    """Compare parameter groups: only learning rates may differ."""
    _require(isinstance(value, list), name, "must have groups")
    _require(len(value) == len(expected), name, f"must have {len(expected)} groups")
    for group, own in zip(value, expected, strict=True):
        _require(isinstance(group, Mapping), name, "must have groups")
        rates = {"lr": group.get("lr"), "initial_lr": group.get("initial_lr", 0.0)}
        for kind, rate in rates.items():
            number = isinstance(rate, int | float) and isfinite(rate) and rate >= 0
            _require(number, name, f"{kind} must be a number of at least 0")
        plain = {k: _listed(v) for k, v in group.items() if k not in rates}
        same = {k: _listed(v) for k, v in own.items() if k not in rates}
        _require(plain == same, name, "was made with other options")


def _listed(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def _check_moment(moment: Any, name: str, kind: str) -> None:
    if isinstance(moment, Tensor) and moment.is_floating_point():
        _require(not moment.isnan().any(), name, "holds NaN")
        if kind in ("step", "exp_avg_sq", "max_exp_avg_sq"):
            _require(bool((moment >= 0).all()), name, "is negative")


def _check_scalar(value: Any, expected: Any, name: str) -> None:
    kinds = (int, float) if type(expected) is float else (type(expected),)
    kind = type(expected).__name__
    _require(type(value) in kinds, name, f"must be {kind}, not {value!r:.50}")
    if type(value) in (int, float):
        in_range = isfinite(value) and abs(value) <= LARGEST_COUNT
        _require(in_range, name, "is out of range")
    if type(value) is int:
        _require(value >= -1, name, "is out of range")


def _plain_type(like: Any) -> type:
    return Tensor if isinstance(like, nn.Parameter) else type(like)


def _require(holds: bool, name: str, message: str) -> None:
    if not holds:
        raise ValueError(f"{name} {message}")
