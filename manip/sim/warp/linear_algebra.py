"""Cholesky factors of small matrices, for kernels; generic in size and precision.

As in `manip.sim.control_laws`, only lower triangles count, and the leading corner of a
factor is the factor of the matrix's leading corner.
"""

from typing import Any

import warp as wp


@wp.func
def factor(a: Any):
    """L of the Cholesky factors L L^T of a [n, n], in the lower triangle."""
    for j in range(len(a)):
        for k in range(j):
            for i in range(j, len(a)):
                a[i, j] = a[i, j] - a[i, k] * a[j, k]
        pivot = wp.sqrt(a[j, j])
        for i in range(j, len(a)):
            a[i, j] = a[i, j] / pivot
    return a


@wp.func
def solve(lower: Any, x: Any):
    """(L L^T)^-1 x; of a longer L, the leading corner counts."""
    for i in range(len(x)):
        for k in range(i):
            x[i] = x[i] - lower[i, k] * x[k]
        x[i] = x[i] / lower[i, i]
    for r in range(len(x)):
        i = len(x) - 1 - r
        for k in range(i + 1, len(x)):
            x[i] = x[i] - lower[k, i] * x[k]
        x[i] = x[i] / lower[i, i]
    return x


@wp.func
def solve_rows(lower: Any, x: Any, rows: int, columns: int):
    """L^-1 applied to each row of x [rows, columns]."""
    for i in range(rows):
        for r in range(columns):
            for k in range(r):
                x[i, r] = x[i, r] - lower[r, k] * x[i, k]
            x[i, r] = x[i, r] / lower[r, r]
    return x
