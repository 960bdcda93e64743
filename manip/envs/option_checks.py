"""Check options and saved states of task batches."""

from collections.abc import Mapping
from numbers import Real
from typing import Any

import numpy as np

from manip.errors import UserError, shown

Array = np.ndarray


def check_share(name: str, value: object) -> None:
    """Raise `UserError` unless the value is a number from 0 to 1."""
    if not isinstance(value, Real) or not 0 <= float(value) <= 1:
        raise UserError(f"{name} must be a number from 0 to 1, not {shown(value)}")


def state_array(state: Mapping[str, Any], name: str, like: Array) -> Array:
    """The array of a saved state that has the shape and dtype of another.

    Raises:
        UserError: it has another shape or dtype: the state is of other environments.
    """
    array = np.asarray(state[name])
    if (array.shape, array.dtype) != (like.shape, like.dtype):
        raise UserError(
            f"{name} of the saved state is {array.dtype} {list(array.shape)}, not "
            f"{like.dtype} {list(like.shape)}: it was saved by other environments"
        )
    return array
