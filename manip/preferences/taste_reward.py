"""The reward of a taste that is known: what a labeller of this taste wants."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch

from manip.preferences.tastes import Taste
from manip.rewards.reward_function import RewardFunction

if TYPE_CHECKING:
    from tensordict import TensorDictBase
    from torch import Tensor

SCALE = 0.2
"""Factor of the rewards. Their values (sums over about 1 / (1 - gamma) = 33 steps) are
then of order 1, which the new critic of a fine-tuned policy learns in few rollouts."""


@dataclass(frozen=True)
class TasteReward:
    """A RewardFunction: another one's reward minus the weighted penalties of a taste.

    The difference is multiplied by `SCALE`.

    Attributes:
        reward: computes the reward without the taste.
        taste: the taste.
        names: of the M measures in ("next", "measures") [N, T, M] of a rollout.
    """

    reward: RewardFunction
    taste: Taste
    names: Sequence[str]

    def __call__(self, rollout: "TensorDictBase") -> "Tensor":
        """Rewards [N, T, 1] float32 of the rollout [N, T]."""
        measures = rollout["next", "measures"].numpy()
        penalties = torch.from_numpy(self.taste.penalties(measures, self.names))
        reward = self.reward(rollout)
        penalty = self.taste.weight * penalties.to(reward.dtype).unsqueeze(-1)
        return SCALE * (reward - penalty)
