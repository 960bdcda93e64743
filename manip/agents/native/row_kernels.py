"""Kernels that change a layer's rows one by one: biases, activations, LayerNorm."""

from typing import Any

import numpy as np

from manip.compiled import fast_kernel

Array = np.ndarray

EPSILON = np.float32(1e-5)
"""Added to the variance (torch.nn.LayerNorm's default)."""

ZERO, HALF, ONE, TWO = (np.float32(x) for x in (0, 0.5, 1, 2))
LOG2_E = np.float32(1 / np.log(2))
LOG_2_HIGH = np.float32(355 / 512)
LOG_2_LOW = np.float32(np.log(2) - 355 / 512)
"""log 2 as a sum: k LOG_2_HIGH is exact in float32 (Cody and Waite 1980)."""
LIMIT = np.float32(40)
"""Largest |x| of `_exp`."""


@fast_kernel
def add_bias(out: Array, bias: Array) -> None:
    """Add bias [w] to every row of out [B, w]."""
    for i in range(len(out)):
        for j in range(len(bias)):
            out[i, j] += bias[j]


@fast_kernel
def sum_rows(values: Array, out: Array) -> None:
    """Write the sum over rows of values [B, w] to out [w]."""
    out[:] = 0
    for i in range(len(values)):
        for j in range(len(out)):
            out[j] += values[i, j]


@fast_kernel
def rectify(z: Array, bias: Array, y: Array) -> None:
    """y = max(0, z + bias)."""
    for i in range(len(z)):
        for j in range(len(bias)):
            y[i, j] = max(ZERO, z[i, j] + bias[j])


@fast_kernel
def saturate(z: Array, bias: Array, y: Array) -> None:
    """y = tanh(z + bias) = 1 - 2 / (exp(2 (z + bias)) + 1); errors are below 1e-7."""
    for i in range(len(z)):
        for j in range(len(bias)):
            y[i, j] = ONE - TWO / (_exp(TWO * (z[i, j] + bias[j])) + ONE)


@fast_kernel
def _exp(x: Any) -> Any:
    """exp(x), x clipped to [-40, 40]; relative errors are below 2e-7.

    exp(x) = 2^k exp(r) with k = round(x / log 2) and r = x - k log 2, |r| <= 0.35, by
    exp's power series. Unlike np.exp, it is inlined, and loops of it are vectorised.
    """
    x = min(max(x, -LIMIT), LIMIT)
    k = np.floor(x * LOG2_E + HALF)
    r = (x - k * LOG_2_HIGH) - k * LOG_2_LOW
    series = ONE  # 1 + r (1 + r/2 (1 + r/3 (...))), Horner's scheme
    for n in (7, 6, 5, 4, 3, 2, 1):
        series = ONE + series * r / np.float32(n)
    # 2^k: k + 127 in the exponent's bits of a float32
    return series * np.int32((np.int32(k) + 127) << 23).view(np.float32)


@fast_kernel
def normalise(
    z: Array, bias: Array, gain: Array, shift: Array, deviation: Array, y: Array
) -> None:
    """LayerNorm in place, z = (z + bias - mean) / deviation; then ReLU.

    y = max(0, gain * z + shift); deviation [B] = sqrt(var + EPSILON) of each row.
    """
    width = np.float32(len(bias))
    for i in range(len(z)):
        row, out = z[i], y[i]
        total, squares = ZERO, ZERO
        for j in range(len(bias)):
            row[j] += bias[j]
            total += row[j]
        mean = total / width
        for j in range(len(bias)):
            row[j] -= mean
            squares += row[j] * row[j]
        deviation[i] = np.sqrt(squares / width + EPSILON)
        scale = ONE / deviation[i]
        for j in range(len(bias)):
            row[j] *= scale
            out[j] = max(ZERO, row[j] * gain[j] + shift[j])
