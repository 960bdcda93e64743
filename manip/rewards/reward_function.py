"""Reward functions: rewards of collected experience, applied before learning."""

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from tensordict import TensorDictBase
    from torch import Tensor


class RewardFunction(Protocol):
    """Compute the rewards of a rollout.

    The rollout holds, besides observations and actions, the environment's own
    ("next", "reward") [N, T, 1] and ("next", "reward_terms") [N, T, K] float32.
    """

    def __call__(self, rollout: "TensorDictBase") -> "Tensor":
        """Rewards [N, T, 1] float32 of the rollout [N, T]."""


class EnvironmentReward:
    """The reward that the environment paid: the weighted sum of the task's terms."""

    def __call__(self, rollout: "TensorDictBase") -> "Tensor":
        """Rewards [N, T, 1] float32 of the rollout [N, T]."""
        reward: Tensor = rollout["next", "reward"]
        return reward
