"""One world of another library, as that library steps it."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

Array = np.ndarray


class ExternalStep(NamedTuple):
    """What a world shows: its observation in named parts [k], and what it earned."""

    parts: Mapping[str, Array]
    reward: float
    success: bool
    terminated: bool


class ExternalSim(ABC):
    """A world that is started from a seed, and stepped; nothing more is asked.

    The same seed and actions give the same sights, whatever the world did before: that
    is how its state is saved and restored.
    """

    @abstractmethod
    def action_dim(self) -> int:
        """A, the length of an action."""

    @abstractmethod
    def start(self, seed: int) -> ExternalStep:
        """Start the episode of a seed, below 2^32; its reward is 0."""

    @abstractmethod
    def step(self, action: Array) -> ExternalStep | None:
        """Take an action [A] in [-1, 1]; None if the physics broke."""

    def repeat(self, seed: int, actions: Array) -> ExternalStep | None:
        """Start the episode of a seed and take actions [T, A]."""
        sight: ExternalStep | None = self.start(seed)
        for action in actions:
            sight = self.step(action)
        return sight
