"""A batch in parts that threads share, for gradients in native code."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import scipy.linalg.cython_blas  # noqa: F401 - loaded now, to be limited below
from threadpoolctl import ThreadpoolController
from torch import Tensor

PART = 128
"""Rows of a batch that a thread takes at a time: fixed, so that sums come out alike."""

Kernel = Callable[..., None]
"""Takes what all parts share, then a part of each input, then the part's scratch."""


def parts_of(batch: int) -> int:
    """How many parts a batch has."""
    return -(-batch // PART)


class Parts:
    """Runs kernels over a batch; each part leaves what it finds in its own scratch.

    BLAS is told to use the calling thread alone: its own threads would get in the way.

    Args:
        scratch: one entry a part.
        threads: how many share the parts.
    """

    def __init__(self, scratch: Sequence[Any], threads: int) -> None:
        ThreadpoolController().select(internal_api="openblas").limit(limits=1)
        self._scratch = scratch
        self._threads = min(threads, len(scratch))
        self._pool = ThreadPoolExecutor(max(1, self._threads - 1), "manip-learn")

    def run(self, kernel: Kernel, shared: Any, *inputs: Tensor) -> None:
        """Call the kernel for every part of the inputs, [B, ...] each."""
        pieces = zip(*(tensor.split(PART) for tensor in inputs), strict=True)
        jobs = [
            (shared, *(piece.numpy() for piece in part), scratch)
            for part, scratch in zip(pieces, self._scratch, strict=True)
        ]
        others = [
            self._pool.submit(_run_all, kernel, jobs[thread :: self._threads])
            for thread in range(1, self._threads)
        ]
        _run_all(kernel, jobs[:: self._threads])
        for other in others:
            other.result()


def _run_all(kernel: Kernel, jobs: Sequence[tuple[Any, ...]]) -> None:
    for job in jobs:
        kernel(*job)
