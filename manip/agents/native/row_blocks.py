"""Run gradient kernels over blocks of a batch's rows, in several threads."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import scipy.linalg.cython_blas  # noqa: F401 - loads BLAS, which is limited below
from threadpoolctl import ThreadpoolController
from torch import Tensor

BLOCK_ROWS = 128
"""Rows of a block. Constant, so that sums do not depend on the number of threads."""

Kernel = Callable[..., None]
"""(what all blocks share, the block of each input, the block's workspace) -> None."""


def count_blocks(batch: int) -> int:
    """Number of blocks of a batch of `batch` rows; the last one may be shorter."""
    return -(-batch // BLOCK_ROWS)


class RowBlocks:
    """Runs kernels over a batch; each block writes its results to its own workspace.

    Limits BLAS to the calling thread: BLAS threads would compete with these.

    Args:
        workspaces: one for each block.
        threads: number of threads that run the blocks.
    """

    def __init__(self, workspaces: Sequence[Any], threads: int) -> None:
        ThreadpoolController().select(internal_api="openblas").limit(limits=1)
        self._workspaces = workspaces
        self._threads = min(threads, len(workspaces))
        self._pool = ThreadPoolExecutor(max(1, self._threads - 1), "manip-learn")

    def run(self, kernel: Kernel, shared: Any, *inputs: Tensor) -> None:
        """Call the kernel for every block of the inputs, [B, ...] each."""
        blocks = zip(*(tensor.split(BLOCK_ROWS) for tensor in inputs), strict=True)
        calls = [
            (shared, *(part.numpy() for part in block), workspace)
            for block, workspace in zip(blocks, self._workspaces, strict=True)
        ]
        futures = [
            self._pool.submit(_run_all, kernel, calls[thread :: self._threads])
            for thread in range(1, self._threads)
        ]
        _run_all(kernel, calls[:: self._threads])
        for future in futures:
            future.result()


def _run_all(kernel: Kernel, calls: Sequence[tuple[Any, ...]]) -> None:
    for arguments in calls:
        kernel(*arguments)
