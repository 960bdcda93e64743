"""Forward and backward passes of multilayer perceptrons, in native code.

A network is a sequence of dense layers z = W x + b. Each layer but the last is followed
by an activation: ReLU, tanh, or LayerNorm (Ba et al. 2016, arXiv 1607.06450) and ReLU.
Its parameters lie in one flat float32 array, layer after layer: W [out, in], b [out],
and LayerNorm's gain and shift [out]. The forward pass writes to a flat tape what the
backward pass reads: of each hidden layer z [B, out] (z normalised, with LayerNorm),
the activation y [B, out], and LayerNorm's deviation [B].
Matrix products are BLAS calls (numba uses SciPy's). Everything else is fused into one
loop over rows, which are in cache then.

d_x denotes the gradient of the loss with respect to x.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from manip.agents.native.row_kernels import (
    ONE,
    ZERO,
    add_bias,
    normalise,
    rectify,
    saturate,
    sum_rows,
)
from manip.compiled import fast_kernel

Array = np.ndarray

RELU, TANH, NORM_RELU = range(3)
"""Activations of hidden layers."""


class Layout(NamedTuple):
    """Offsets of a network's layers in its flat arrays.

    widths: [L + 1] of input, hidden layers and output; params_at, tape_at: [L] start of
    each layer in the parameters and on the tape; activation: RELU, TANH or NORM_RELU.
    """

    widths: Array
    params_at: Array
    tape_at: Array
    activation: int


def layout_of(widths: Sequence[int], activation: int, rows: int) -> Layout:
    """The layout of a network with a tape for batches of up to `rows`."""
    inputs, outputs = np.array(widths[:-1]), np.array(widths[1:])
    hidden = np.arange(len(outputs)) < len(outputs) - 1
    extra = np.where(hidden & (activation == NORM_RELU), 2, 0)
    sizes = outputs * (inputs + 1 + extra)
    tape = rows * (2 * outputs + 1)
    return Layout(np.array(widths), _starts(sizes), _starts(tape), activation)


def tape_size(layout: Layout, rows: int) -> int:
    """Length of the tape for batches of up to `rows`."""
    return int(rows * (2 * layout.widths[1:-1] + 1).sum())


def zeros_of(shapes: Mapping[str, tuple[int, ...]], blocks: int) -> dict[str, Array]:
    """Name -> zeros [blocks, *shape] float32: workspaces of the blocks of a batch."""
    return {n: np.zeros((blocks, *shape), np.float32) for n, shape in shapes.items()}


def _starts(sizes: Array) -> Array:
    return np.concatenate([[0], np.cumsum(sizes)[:-1]])


@fast_kernel
def _matrix(flat: Array, at: int, rows: int, columns: int) -> Array:
    """View [rows, columns] of a flat array, from offset `at`."""
    return flat[at : at + rows * columns].reshape(rows, columns)


@fast_kernel
def forward(params: Array, layout: Layout, x: Array, tape: Array, out: Array) -> None:
    """Compute the network's output for x [B, in] into out [B, out]; fill the tape."""
    rows, last = len(x), len(layout.widths) - 2
    for k in range(last + 1):
        inputs, width = layout.widths[k], layout.widths[k + 1]
        at = layout.params_at[k]
        weight = _matrix(params, at, width, inputs)
        at += width * inputs
        bias = params[at : at + width]
        if k == last:
            np.dot(x, weight.T, out)  # out = x W^T + b
            add_bias(out, bias)
            return
        to = layout.tape_at[k]
        z = _matrix(tape, to, rows, width)
        y = _matrix(tape, to + rows * width, rows, width)
        deviation = tape[to + 2 * rows * width : to + 2 * rows * width + rows]
        np.dot(x, weight.T, z)  # z = x W^T; the activation adds b
        if layout.activation == NORM_RELU:
            gain = params[at + width : at + 2 * width]
            shift = params[at + 2 * width : at + 3 * width]
            normalise(z, bias, gain, shift, deviation, y)
        elif layout.activation == RELU:
            rectify(z, bias, y)
        else:
            saturate(z, bias, y)
        x = y


@fast_kernel
def backward(
    params: Array,
    layout: Layout,
    x: Array,
    tape: Array,
    d_out: Array,
    scratch: Array,
    grads: Array,
) -> None:
    """Write the gradients of sum(out * d_out) by the parameters to `grads`.

    Args:
        x: [B, in], input of the forward pass that wrote `tape`.
        d_out: [B, out].
        scratch: [2, S] for d_y of layers in turn, S >= B times the widest layer.
    """
    d_z = d_out
    for k in range(len(layout.widths) - 2, -1, -1):
        inputs, width = layout.widths[k], layout.widths[k + 1]
        at = layout.params_at[k]
        below = x if k == 0 else _output(layout, tape, k - 1, len(x))
        np.dot(d_z.T, below, _matrix(grads, at, width, inputs))  # dW = d_z^T below
        at += width * inputs
        sum_rows(d_z, grads[at : at + width])  # db = sum over rows of d_z
        if k > 0:
            d_y = _down(params, layout, tape, k, d_z, scratch[k % 2])
            if layout.activation == NORM_RELU:
                _norm_gradients(layout, tape, k - 1, d_y, grads)
                _through_norm(params, layout, tape, k - 1, d_y)
            d_z = d_y


@fast_kernel
def backward_to_input(
    params: Array, layout: Layout, tape: Array, d_out: Array, scratch: Array, d_x: Array
) -> None:
    """Write the gradient of sum(out * d_out) by the input to d_x; see `backward`.

    Args:
        d_x: [B, in].
    """
    d_z = d_out
    for k in range(len(layout.widths) - 2, 0, -1):
        d_y = _down(params, layout, tape, k, d_z, scratch[k % 2])
        if layout.activation == NORM_RELU:
            _through_norm(params, layout, tape, k - 1, d_y)
        d_z = d_y
    # d_x = d_z W of the first layer
    np.dot(d_z, _matrix(params, 0, layout.widths[1], layout.widths[0]), d_x)


@fast_kernel
def _down(
    params: Array, layout: Layout, tape: Array, k: int, d_z: Array, scratch: Array
) -> Array:
    """Return d by the input of the activation below layer k, from d_z of layer k.

    [B, width], in `scratch`. The activation's input is z with tanh or ReLU, and
    gain * unit + shift with LayerNorm.
    """
    width = layout.widths[k]
    d_y = _matrix(scratch, 0, len(d_z), width)
    # d_y = d_z W
    np.dot(d_z, _matrix(params, layout.params_at[k], layout.widths[k + 1], width), d_y)
    y = _output(layout, tape, k - 1, len(d_z))
    if layout.activation == TANH:
        for i in range(len(d_y)):
            for j in range(width):
                d_y[i, j] *= ONE - y[i, j] * y[i, j]  # tanh' = 1 - tanh^2
    else:
        for i in range(len(d_y)):
            for j in range(width):
                d_y[i, j] = d_y[i, j] if y[i, j] > 0 else ZERO
    return d_y


@fast_kernel
def _output(layout: Layout, tape: Array, k: int, rows: int) -> Array:
    """Activation [rows, width] of hidden layer k, on the tape behind its z."""
    width = layout.widths[k + 1]
    return _matrix(tape, layout.tape_at[k] + rows * width, rows, width)


@fast_kernel
def _norm_gradients(
    layout: Layout, tape: Array, k: int, d_y: Array, grads: Array
) -> None:
    """Write the gradients of layer k's gain and shift, from d_y of their output [B, w].

    d_gain = sum over rows of d_y * unit, d_shift = sum over rows of d_y, where unit is
    the normalised z.
    """
    rows, width = d_y.shape
    unit = _matrix(tape, layout.tape_at[k], rows, width)
    at = layout.params_at[k] + width * (layout.widths[k] + 1)
    d_gain, d_shift = grads[at : at + width], grads[at + width : at + 2 * width]
    d_gain[:] = 0
    d_shift[:] = 0
    for i in range(rows):
        for j in range(width):
            d_gain[j] += d_y[i, j] * unit[i, j]
            d_shift[j] += d_y[i, j]


@fast_kernel
def _through_norm(params: Array, layout: Layout, tape: Array, k: int, d: Array) -> None:
    """Turn d by the output of layer k's LayerNorm into d by its input, in place.

    d = (g - mean(g) - unit * mean(g * unit)) / deviation with g = gain * d, means over
    the row, and the normalised z as unit.
    """
    rows, width = d.shape
    to = layout.tape_at[k]
    unit = _matrix(tape, to, rows, width)
    deviation = tape[to + 2 * rows * width : to + 2 * rows * width + rows]
    at = layout.params_at[k] + width * (layout.widths[k] + 1)
    gain = params[at : at + width]
    for i in range(rows):
        mean, along = ZERO, ZERO
        for j in range(width):
            d[i, j] *= gain[j]
            mean += d[i, j]
            along += d[i, j] * unit[i, j]
        mean /= np.float32(width)
        along /= np.float32(width)
        scale = ONE / deviation[i]
        for j in range(width):
            d[i, j] = (d[i, j] - mean - unit[i, j] * along) * scale
