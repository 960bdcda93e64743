"""Reward functions: rewards of collected experience, applied before learning."""

from collections.abc import Sequence
from dataclasses import dataclass
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


@dataclass(frozen=True)
class WeightedTerms:
    """The same from the reward terms, for steps whose reward was replaced.

    Attributes:
        weights: of the K terms, in their order.
    """

    weights: Sequence[float]

    def __call__(self, rollout: "TensorDictBase") -> "Tensor":
        """Rewards [N, T, 1] float32 of the rollout [N, T]."""
        terms: Tensor = rollout["next", "reward_terms"]
        return terms @ terms.new_tensor(self.weights)[:, None]
