"""Clips that were compared in pairs, as tensors to learn from."""

from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True)
class ComparedClips:
    """P pairs of clips of L steps, with their answers.

    Attributes:
        left, right: [P, L, F] numbers that describe each step.
        target: [P] 1 if left is better, 0 if right is, 1/2 for equal.
    """

    left: Tensor
    right: Tensor
    target: Tensor

    def __len__(self) -> int:
        """P."""
        return len(self.target)

    def at(self, rows: Tensor) -> "ComparedClips":
        """The pairs at `rows`, [B] or [K, B] integers."""
        return ComparedClips(self.left[rows], self.right[rows], self.target[rows])
