"""Bounded reward kernels: numbers in [0, 1], each with a physical parameter.

All take and return arrays of any shape, of numpy or torch, and are computed
elementwise.
"""

import numpy as np

from manip.arrays import namespace
from manip.errors import UserError

Array = np.ndarray


def near(distance: Array, length: float) -> Array:
    """1 - tanh(distance / length): 1 at zero, 0.24 at `length` [m].

    robosuite's reaching term is this with length 0.1 m (environments/manipulation).
    """
    return 1.0 - namespace(distance).tanh(distance / length)


def ramp(x: Array, low: float, high: float) -> Array:
    """0 up to `low`, 1 from `high`, linear between.

    Raises:
        UserError: `low` is not below `high`.
    """
    if not low < high:
        raise UserError(f"a ramp needs low < high, not low {low} and high {high}")
    return namespace(x).clip((x - low) / (high - low), 0.0, 1.0)


def tolerance(
    x: Array, low: float, high: float, margin: float, value_at_margin: float = 0.1
) -> Array:
    """1 inside [low, high], a Gaussian fall outside: `value_at_margin` at `margin`.

    The same function as dm_control.utils.rewards.tolerance with its default sigmoid.

    Raises:
        UserError: bounds out of order, margin not positive, value not in (0, 1).
    """
    if low > high or margin <= 0 or not 0 < value_at_margin < 1:
        raise UserError(
            "tolerance needs low <= high, margin > 0 and 0 < value_at_margin < 1, not "
            f"{low}, {high}, {margin} and {value_at_margin}"
        )
    xp = namespace(x)
    outside = xp.clip(xp.maximum(low - x, x - high), 0.0, None) / margin
    return xp.exp(float(np.log(value_at_margin)) * outside**2)
