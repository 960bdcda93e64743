"""Equality of trees: nested dicts and lists of tensors, arrays and numbers."""

from typing import Any

import numpy as np
import torch


def assert_same(found: Any, expected: Any) -> None:
    assert type(found) is type(expected)
    if isinstance(expected, dict):
        assert found.keys() == expected.keys()
        for key, value in expected.items():
            assert_same(found[key], value)
    elif isinstance(expected, list):
        assert len(found) == len(expected)
        for mine, value in zip(found, expected, strict=True):
            assert_same(mine, value)
    elif isinstance(expected, torch.Tensor | np.ndarray):
        assert (found.dtype, found.shape) == (expected.dtype, expected.shape)
        assert bool((found == expected).all())
    else:
        assert found == expected
