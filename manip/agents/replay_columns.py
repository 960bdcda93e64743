"""Columns of the replay buffer: their memory, and the check of saved ones."""

from collections.abc import Mapping, Sequence
from math import prod
from typing import Any

import numpy as np
import torch
from torch import Tensor

from manip.errors import UserError
from manip.observation import ObservationPart

OPTIONAL = {"terms": "reward_terms", "measures": "measures"}
"""Column -> key of a rollout's `next` that it stores, where rollouts have it."""

NONE = -1
"""Link of a row that is the last of its episode or rollout."""


def image_before(camera: str) -> str:
    """Name of the column of a camera's images at the steps' states."""
    return f"before:{camera}"


def image_after(camera: str) -> str:
    """Name of the column of a camera's images at the steps' successors."""
    return f"after:{camera}"


def row_bytes(
    observation_dim: int,
    action_dim: int,
    cameras: Sequence[ObservationPart] = (),
    image_copies: int = 2,
) -> int:
    """Bytes of a stored step: action and two observations (float32), images (uint8).

    Args:
        image_copies: images of each camera; a replay buffer has those before and after
            the step.
    """
    images = sum(prod(camera.shape) for camera in cameras)
    return 4 * (2 * observation_dim + action_dim) + image_copies * images


def allocate(
    capacity: int,
    observations: int,
    actions: int,
    cameras: Sequence[ObservationPart],
    device: torch.device,
) -> dict[str, Tensor]:
    """Allocate the columns of a buffer; see `manip.agents.replay.Replay`.

    Raises:
        UserError: there is not enough memory.
    """
    try:
        columns = {
            "before": _zeros(np.float32, capacity, observations + actions),
            "after": _zeros(np.float32, capacity, observations),
            "reward": _zeros(np.float32, capacity),
            "terminated": _zeros(np.bool_, capacity),
            "ended": _zeros(np.bool_, capacity),
            **{name: _zeros(np.float32, capacity, 0) for name in OPTIONAL},
            "env": _zeros(np.int32, capacity),
            "episode": _zeros(np.int64, capacity),
            "link": _zeros(np.int64, capacity),
            **{
                name(camera.name): _zeros(np.uint8, capacity, *camera.shape)
                for camera in cameras
                for name in (image_before, image_after)
            },
        }
        return {name: column.to(device) for name, column in columns.items()}
    except (RuntimeError, MemoryError) as error:  # torch's allocator, numpy's
        size = capacity * row_bytes(observations, actions, cameras) / 2**30
        raise UserError(
            f"no memory for {capacity:,} stored steps ({size:,.1f} GiB): choose a "
            "smaller agent.buffer_size"
        ) from error


def _zeros(kind: type[np.generic], *shape: int) -> Tensor:
    """Zeros that take memory and time only where they have been written."""
    return torch.from_numpy(np.zeros(shape, kind))


def check_columns(
    stored: Mapping[str, Tensor], columns: Mapping[str, Tensor], size: int
) -> None:
    """Compare saved columns of so many rows with those of a buffer.

    Raises:
        ValueError: names, shapes or types differ, or the rows do not fit.
    """
    if stored.keys() != columns.keys():
        raise ValueError(f"a replay buffer of columns {', '.join(stored)}")
    for name, column in columns.items():
        value, shape = stored[name], (size, *column.shape[1:])
        if value.shape != shape or value.dtype != column.dtype or size > len(column):
            raise ValueError(
                f"column {name} of the replay buffer is {value.dtype} "
                f"{[*value.shape]}, not {column.dtype} {[*shape]}"
            )


def check_links(state: Mapping[str, Any], size: int, capacity: int) -> None:
    """Check a saved buffer's counters, and that its links lead to stored rows.

    Raises:
        ValueError: one of them is out of range.
    """
    cursor, current = state["cursor"], state["current"]
    if not (isinstance(cursor, int) and isinstance(state["episodes"], int)):
        raise ValueError("the replay buffer's counters are not whole numbers")
    if not 0 <= cursor < capacity or (size < capacity and cursor != size):
        raise ValueError(f"the replay buffer's cursor is {cursor}")
    link = state["buffer"]["link"] if size else current[:0]
    if ((link < NONE) | (link >= size)).any():
        raise ValueError("the replay buffer links to steps that are not stored")
    if current.dtype != torch.int64 or current.ndim != 1:
        raise ValueError("the replay buffer's episode numbers are no row of integers")
