"""Measure some environments of a batch again, and put them among the others."""

from collections.abc import Mapping
from typing import Any

import numpy as np

Array = np.ndarray


def rows_of(read: Mapping[str, Array], env_ids: Array, num_envs: int) -> dict[str, Any]:
    """Rows env_ids of readings [N, ...]; those of shape [1, ...] hold for all."""
    return {
        name: values[env_ids] if len(values) == num_envs else values
        for name, values in read.items()
    }


def with_rows(
    measures: Mapping[str, Any],
    rows: Mapping[str, Any],
    env_ids: Array,
    num_envs: int,
) -> dict[str, Any]:
    """Copies of measures [N, ...] with the rows env_ids replaced by rows [n, ...].

    Measures without a row for each environment hold for all, and stay.
    """
    return {
        name: _with_rows(values, rows[name], env_ids)
        if _is_batched(values, rows[name], (num_envs, len(env_ids)))
        else values
        for name, values in measures.items()
    }


def _is_batched(values: Any, rows: Any, lengths: tuple[int, int]) -> bool:
    shapes = np.shape(values), np.shape(rows)
    return all(shapes) and (shapes[0][0], shapes[1][0]) == lengths


def _with_rows(values: Any, rows: Any, env_ids: Array) -> Array:
    merged = np.array(values)
    merged[env_ids] = rows
    return merged
