"""The contract of a simulation that another library steps."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from manip.sim.not_copied import NotCopied

Array = np.ndarray


class ExternalStep(NamedTuple):
    """What one environment returns.

    Attributes:
        parts: name -> [k], the observation.
        reward, success, terminated: the library's own.
        images: camera part -> uint8 [H, W, 3], bottom row first.
    """

    parts: Mapping[str, Array]
    reward: float
    success: bool
    terminated: bool
    images: Mapping[str, Array] = {}


class ExternalSim(NotCopied, ABC):
    """One environment of another library, started from a seed.

    The same seed and actions give the same steps, independent of earlier episodes: its
    state is saved as seed and actions, and restored by repeating them.
    """

    @abstractmethod
    def action_dim(self) -> int:
        """A, the length of an action."""

    @abstractmethod
    def start(self, seed: int) -> ExternalStep:
        """Start the episode of a seed below 2^32; the reward is 0."""

    @abstractmethod
    def step(self, action: Array) -> ExternalStep | None:
        """Take an action [A] in [-1, 1]; None if the physics became unstable."""

    def repeat(self, seed: int, actions: Array) -> ExternalStep | None:
        """Start the episode of a seed and take actions [T, A]; the last step."""
        latest: ExternalStep | None = self.start(seed)
        for action in actions:
            latest = self.step(action)
        return latest
