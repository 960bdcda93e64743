"""Minimum, maximum, mean and standard deviation of a feature, added part by part."""

from typing import Any

import numpy as np

Array = np.ndarray

EVERY = 10
"""Of this many images, one is counted."""


class FeatureStats:
    """Statistics of numbers [T, k], or of images for each channel, from 0 to 1.

    Attributes:
        count: rows, or images, so far.
    """

    def __init__(self) -> None:
        self.count = self._number = 0
        self._shape: tuple[int, ...] = (-1,)
        self._sum = self._squares = np.zeros(1)
        self._low, self._high = np.full(1, np.inf), np.full(1, -np.inf)

    def add(self, values: Array) -> None:
        """Add numbers [T] or [T, k]."""
        self._add(values.reshape(len(values), -1).astype(np.float64), len(values))

    def add_images(self, images: Array) -> None:
        """Add a share of the images [T, H, W, C] uint8."""
        chosen = images[::EVERY]
        self._shape = (-1, 1, 1)
        self._add(chosen.reshape(-1, images.shape[-1]) / 255.0, len(chosen))

    def values(self) -> dict[str, Any]:
        """As LeRobot stores them; images have the shape [C, 1, 1]."""
        mean = self._sum / self._number
        spread = np.sqrt(np.maximum(self._squares / self._number - mean**2, 0))
        named = {"min": self._low, "max": self._high, "mean": mean, "std": spread}
        lists = {name: v.reshape(self._shape).tolist() for name, v in named.items()}
        return lists | {"count": [self.count]}

    def _add(self, rows: Array, count: int) -> None:
        self._number += len(rows)
        self.count += count
        self._sum = self._sum + rows.sum(0)
        self._squares = self._squares + (rows**2).sum(0)
        self._low = np.minimum(self._low, rows.min(0))
        self._high = np.maximum(self._high, rows.max(0))
