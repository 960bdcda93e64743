"""Equality of trees: nested dicts and lists of tensors, arrays and numbers."""

from typing import Any

import numpy as np
import torch


def assert_same(actual: Any, expected: Any) -> None:
    """Assert that two trees have the same types, shapes and bits."""
    assert type(actual) is type(expected)
    if isinstance(expected, dict):
        assert actual.keys() == expected.keys()
        for key, value in expected.items():
            assert_same(actual[key], value)
    elif isinstance(expected, list):
        assert len(actual) == len(expected)
        for pair in zip(actual, expected, strict=True):
            assert_same(*pair)
    elif isinstance(expected, torch.Tensor | np.ndarray):
        assert (actual.dtype, actual.shape) == (expected.dtype, expected.shape)
        assert bool((actual == expected).all())
    else:
        assert actual == expected
