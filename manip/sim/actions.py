"""Check the shape and type of actions."""

from typing import Any

import numpy as np

from manip.errors import UserError, shown

Array = np.ndarray


def checked_actions(action: Any, num_envs: int, action_dim: int) -> Array:
    """Return an action as float64 [num_envs, action_dim].

    NaN passes: it breaks its own environment only.

    Raises:
        UserError: it has another shape, or holds something else than real numbers.
    """
    values = _real(action, (num_envs, action_dim), "(num_envs, action_dim)")
    return np.ascontiguousarray(values, dtype=np.float64)


def batch_of_one(action: Any, action_dim: int) -> Array:
    """Return the action [action_dim] of one environment as [1, action_dim].

    Raises:
        UserError: it has another shape, or holds something else than real numbers.
    """
    return _real(action, (action_dim,), "(action_dim,)")[None]


def _real(action: Any, expected: tuple[int, ...], words: str) -> Array:
    try:
        values = np.asarray(action)
    except (RuntimeError, TypeError, ValueError):  # ragged, or needs gradients
        raise _not_numbers(action, expected) from None
    if values.dtype.kind not in "biuf":
        raise _not_numbers(action, expected)
    if values.shape != expected:
        raise UserError(
            f"the action has shape {values.shape}, expected {expected}, that is {words}"
        )
    return values


def _not_numbers(action: Any, expected: tuple[int, ...]) -> UserError:
    return UserError(
        f"the action must be real numbers of shape {expected}, not {shown(action)}"
    )
