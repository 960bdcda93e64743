"""Check options and saved states of task batches."""

from collections.abc import Mapping
from numbers import Real
from typing import Any

import numpy as np

from manip.errors import UserError, shown

Array = np.ndarray


def check_share(name: str, value: object) -> None:
    """Raise `UserError` unless the value is a number from 0 to 1."""
    number = isinstance(value, Real) and not isinstance(value, bool)
    if not number or not 0 <= float(value) <= 1:  # type: ignore[arg-type]
        raise UserError(f"{name} must be a number from 0 to 1, not {shown(value)}")


def check_flag(name: str, value: object) -> None:
    """Raise `UserError` unless the value is True or False."""
    if not isinstance(value, bool | np.bool_):
        raise UserError(f"{name} must be True or False, not {shown(value)}")


def state_array(state: Mapping[str, Any], name: str, like: Array) -> Array:
    """The array of a saved state that has the shape and dtype of another.

    Raises:
        UserError: it is missing, or has another shape or dtype: the state is of other
            environments.
    """
    if not isinstance(state, Mapping) or name not in state:
        raise UserError(f"the saved state has no {name}: {shown(state)}")
    array = np.asarray(state[name])
    if (array.shape, array.dtype) != (like.shape, like.dtype):
        raise UserError(
            f"{name} of the saved state is {array.dtype} {list(array.shape)}, not "
            f"{like.dtype} {list(like.shape)}: it was saved by other environments"
        )
    return array
