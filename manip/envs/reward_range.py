"""Check that shaped rewards are in [0, 1] per step."""

import warnings

import numpy as np

from manip.envs.task import Task

Array = np.ndarray

ROUNDING = 1e-6
"""How far sums of weights and terms may leave the range."""


class RewardRange:
    """Warn once if a task's shaped reward leaves [0, 1].

    Args:
        task: the task.
        checked: whether its own weights of the shaped set are paid.
    """

    def __init__(self, task: Task, checked: bool) -> None:
        self._task = task
        self._checked = checked

    def check(self, reward: Array) -> None:
        """Compare the rewards [N] of a step; NaN is recorded as a fault instead."""
        if self._checked and (reward.max() > 1 + ROUNDING or reward.min() < -ROUNDING):
            self._checked = False
            warnings.warn(
                f"task {self._task.name!r}: a step pays from {reward.min():g} to "
                f"{reward.max():g} with the shaped reward, not from 0 to 1: keep each "
                "term from 0 to 1",
                stacklevel=2,
            )
