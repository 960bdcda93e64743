"""MeasureCache: a task's measures, computed once per state of the environments."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from manip.arrays import is_tensor
from manip.envs.task import Measures, Task

Array = np.ndarray


class MeasureCache:
    """The task's measures of the present state.

    Args:
        task: the task.
        num_envs: N.
        read: returns the present readings of all environments.
        version: returns a value that differs once the state has changed.
    """

    def __init__(
        self,
        task: Task,
        num_envs: int,
        read: Callable[[], Measures],
        version: Callable[[], object],
    ) -> None:
        self._task = task
        self._num_envs = num_envs
        self._read, self._version = read, version
        self._measures: Measures = {}
        self._measured: object = None

    def get(self) -> Measures:
        """Measures [N, ...]; computed anew if the state has changed."""
        version = self._version()
        if version != self._measured:
            self._measures, self._measured = self._task.measure(self._read()), version
        return self._measures

    @contextmanager
    def restarting(self, env_ids: Array) -> Iterator[None]:
        """Measure only the environments that change inside the `with` block.

        Tensors are measured anew as a whole, when they are needed.
        """
        partial = self._version() == self._measured and len(env_ids) < self._num_envs
        partial &= not any(map(is_tensor, self._measures.values()))
        yield
        if partial:
            rows = self._task.measure(rows_of(self._read(), env_ids, self._num_envs))
            self._measures = with_rows(self._measures, rows, env_ids, self._num_envs)
            self._measured = self._version()


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
        if _has_rows(values, num_envs) and _has_rows(rows[name], len(env_ids))
        else values
        for name, values in measures.items()
    }


def _has_rows(values: Any, number: int) -> bool:
    shape = np.shape(values)
    return bool(shape) and shape[0] == number


def _with_rows(values: Any, rows: Any, env_ids: Array) -> Array:
    merged = np.array(values)
    merged[env_ids] = rows
    return merged
