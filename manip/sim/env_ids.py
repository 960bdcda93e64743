"""Check the environments that a caller names."""

from typing import Any

import numpy as np

from manip.errors import UserError, shown

Array = np.ndarray


def checked_env_ids(env_ids: Any, num_envs: int) -> Array:
    """Return indices of different environments as int64 [n].

    Raises:
        UserError: they are no whole numbers from 0 to num_envs - 1, or not different.
    """
    try:
        ids = np.asarray(env_ids)
    except (RuntimeError, TypeError, ValueError):  # ragged, or not on the CPU
        raise _not_ids(env_ids, num_envs) from None
    whole = ids.dtype.kind in "iu" or not ids.size
    different = ids.ndim == 1 and len(np.unique(ids)) == len(ids)
    if not whole or not different or (ids < 0).any() or (ids >= num_envs).any():
        raise _not_ids(env_ids, num_envs)
    return ids.astype(np.int64)


def _not_ids(env_ids: Any, num_envs: int) -> UserError:
    return UserError(
        f"env_ids must be different whole numbers from 0 to {num_envs - 1}, "
        f"not {shown(env_ids)}"
    )
