"""Compare native gradients with those of TorchRL's losses, and choose between them."""

import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Generic, Literal, TypeVar

import torch
from torch import Tensor

TOLERANCE = 1e-4
"""Relative difference allowed in each parameter's gradient and each reported number.

float32 rounding: at most 7e-5, and in 99 % below 7e-6, in 900 comparisons at the start
of 600 runs; at most 1.5e-5 in 4,000 comparisons within runs, where two more met a kink.
"""

FLOOR = 0.1
"""Least norm that differences of numbers, and of gradients in a run, are relative to.

Sums of many rows may vanish, but their rounding errors do not.
"""

INTERVAL = 1000
"""Updates between two comparisons on batches of a run."""

ATTEMPTS = 3
"""Batches that must all differ before native gradients are given up.

A kink makes a single batch differ: a ReLU's input within rounding of 0, equal critics,
a ratio within rounding of the clip range. An error makes every batch differ.
"""

GradientSource = Literal["native", "torchrl"]
"""native: native code, compared with TorchRL's losses; torchrl: these, and autograd."""

Gradients = TypeVar("Gradients")
Measured = Mapping[str, Tensor]
"""Name -> gradient of each parameter, and each number that is reported."""


class GradientCheck(ABC, Generic[Gradients]):
    """Native gradients while they agree with TorchRL's, TorchRL's from then on.

    Compares them on probes at the start, then on the first batch of a run and every
    1000th. Comparing changes no parameter and no random number of the run.

    Attributes:
        in_use: the gradients to learn from.
    """

    def __init__(self, native: Gradients, reference: Gradients) -> None:
        self.in_use = native
        self._native, self._reference = native, reference
        self._updates = self._failures = 0

    @abstractmethod
    def _measure(self, gradients: Gradients, rows: Tensor) -> Measured:
        """Compute all gradients for a batch of rows; return copies of them."""

    def _agree_on_probe(self, probe: Callable[[int], Tensor]) -> bool:
        """Return whether the gradients agree on one of some batches: seed -> rows."""
        batches = (probe(seed) for seed in range(ATTEMPTS))
        return any(self._agree(rows, floor=0.0) for rows in batches)

    def _select(self, rows: Tensor) -> Gradients:
        """Return the gradients for an update, compared on its rows when it is time."""
        if self._failures or self._updates % INTERVAL == 0:
            self._check_batch(rows)
        self._updates += 1
        return self.in_use

    def _check_batch(self, rows: Tensor) -> None:
        agree = self.in_use is self._reference or self._agree(rows, FLOOR)
        self._failures = 0 if agree else self._failures + 1
        if self._failures == ATTEMPTS:
            self._failures = 0
            self._fall_back()

    def _agree(self, rows: Tensor, floor: float) -> bool:
        native, reference = [
            self._measure_with_seed(gradients, rows)
            for gradients in (self._native, self._reference)
        ]
        return not differing(native, reference, floor)

    def _measure_with_seed(self, gradients: Gradients, rows: Tensor) -> Measured:
        """Measure with the same noise for any gradients, and none of the run's."""
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(0)
            return self._measure(gradients, rows)

    def _fall_back(self) -> None:
        self.in_use = self._reference
        warnings.warn(
            "native gradients differ from TorchRL's on this machine: training "
            "continues with TorchRL's losses and autograd, which is slower",
            stacklevel=2,
        )


def differing(native: Measured, reference: Measured, floor: float) -> list[str]:
    """Return the names of what differs.

    Skips what is not finite in the reference: a batch with NaN proves nothing.

    Args:
        floor: of gradients; numbers have FLOOR.
    """
    return [
        name
        for name, expected in reference.items()
        if expected.isfinite().all()
        and not _close(native[name], expected, floor if expected.ndim else FLOOR)
    ]


def _close(value: Tensor, expected: Tensor, floor: float) -> bool:
    scale = max(expected.norm().item(), floor)
    return (value - expected).norm().item() <= TOLERANCE * scale


@contextmanager
def perturbed(tensors: Iterable[Tensor], spread: float = 0.1) -> Iterator[None]:
    """Add normal noise to tensors, and restore them exactly at the end.

    Initial parameters hide errors: zero biases, unit gains, equal log deviations, and
    targets that equal the critics.
    """
    draw = torch.Generator().manual_seed(0)
    originals = [(tensor, tensor.clone()) for tensor in tensors]
    for tensor, _ in originals:
        tensor.add_(spread * torch.randn(tensor.shape, generator=draw))
    try:
        yield
    finally:
        for tensor, original in originals:
            tensor.copy_(original)
