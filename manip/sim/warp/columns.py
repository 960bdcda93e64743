"""Copy columns between rows on the device and the arrays of MuJoCo Warp."""

from typing import Any

import warp as wp

FLOAT_BYTES = 4


def flat(array: Any) -> Any:
    """A view [N, k] float32 of an array [N, ...] of vectors, matrices or numbers."""
    if not array.is_contiguous:
        raise AssertionError(f"not contiguous: shape {array.shape}")
    size = array.size * wp.types.type_size_in_bytes(array.dtype) // FLOAT_BYTES
    shape = array.shape[0], size // array.shape[0]
    return wp.array(ptr=array.ptr, dtype=float, shape=shape, device=array.device)


@wp.kernel(enable_backward=False)
def _gather(
    source: wp.array2d[float], start: int, rows: wp.array2d[float], at: int
) -> None:
    env, k = wp.tid()
    rows[env, at + k] = source[env, start + k]


@wp.kernel(enable_backward=False)
def _scatter(
    rows: wp.array2d[float],
    at: int,
    env_ids: wp.array[int],
    target: wp.array2d[float],
    start: int,
) -> None:
    i, k = wp.tid()
    target[env_ids[i], start + k] = rows[i, at + k]


def gather(source: Any, start: int, size: int, rows: Any, at: int) -> None:
    """rows[:, at : at + size] = source[:, start : start + size]."""
    if size:
        inputs = [source, start, rows, at]
        wp.launch(_gather, dim=(rows.shape[0], size), inputs=inputs)


def scatter(rows: Any, at: int, env_ids: Any, count: int, place: "Place") -> None:
    """Copy columns from `at` of the first `count` rows to their environments' place."""
    if place.size and count:
        inputs = [rows, at, env_ids, place.array, place.start]
        wp.launch(_scatter, dim=(count, place.size), inputs=inputs)


class Place:
    """Columns start to start + size of an array [N, k] on the device."""

    def __init__(self, array: Any, start: int = 0, size: int | None = None) -> None:
        self.array, self.start = flat(array), start
        self.size = self.array.shape[1] if size is None else size
        self._owner = array  # the view does not keep the memory alive
