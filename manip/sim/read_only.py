"""Make returned arrays read-only."""

import numpy as np


def read_only(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Make the arrays read-only, in place: writing to one then raises `ValueError`.

    A view becomes read-only without its base.
    """
    for values in arrays.values():
        values.flags.writeable = False
    return arrays
