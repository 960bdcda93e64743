"""Clone what was rated best: the supervised contrast to learning from a reward.

    actor: max E log pi(a | s),  (s, a) ~ the best of what was done

The best of what was done are the winners of comparisons, in every round from the
reference again; or the best fraction of new episodes, by their mean learned reward,
each time that enough of them were collected (reward-ranked fine-tuning, Dong et al.
2023, arXiv 2304.06767).
"""

from dataclasses import dataclass
from typing import Annotated, Any, Literal

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.modules import IndependentNormal

from manip.agents.agent import Spaces
from manip.agents.compared_clips import ComparedClips
from manip.agents.off_policy import descend
from manip.agents.reference import FineTuning, FineTuningConfig
from manip.agents.replay import Replay
from manip.io.option_ranges import COUNT, SHARE
from manip.rewards.reward_function import RewardFunction


@dataclass(frozen=True)
class CloneBestConfig(FineTuningConfig):
    """Options of cloning the best; `reference` is needed."""

    source: Literal["winners", "episodes"] = "episodes"
    """What is cloned: the winners of comparisons, or the best new episodes."""
    fraction: Annotated[float, SHARE] = 0.1
    """Fraction of the new episodes that is cloned."""
    buffer_size: Annotated[int, COUNT] = 20_000
    """Control steps of new episodes among which the best are chosen."""
    epochs: Annotated[int, COUNT] = 20
    """Passes over the chosen steps."""
    batch_size: Annotated[int, COUNT] = 256
    """Steps per update (minibatch size)."""


class CloneBest(FineTuning):
    """Cloning the best; see the module's docstring."""

    name = "clone-best"
    Config = CloneBestConfig

    def __init__(
        self, config: CloneBestConfig, spaces: Spaces, threads: int = 1
    ) -> None:
        self.config = config
        super().__init__(config, spaces, threads)
        self._widths = spaces.observation_dim, spaces.action_dim
        self._replay = self._new_replay()

    def update(self, batch: TensorDictBase) -> dict[str, float]:
        """Store the rollout [N, T]; once the buffer is full, clone the best in it."""
        if self.config.source == "winners":
            return {}
        if len(self._replay) + batch.numel() <= self.config.buffer_size:
            self._replay.add(batch)
            return {}
        best = best_steps(self._replay.steps(), self.config.fraction)
        self._replay = self._new_replay()
        self._replay.add(batch)
        return self._clone(best["observation"], best["action"])

    def relabel(self, reward: RewardFunction) -> None:
        """Replace the rewards of the stored steps."""
        self._replay.relabel(reward)

    def compare(self, pairs: ComparedClips) -> dict[str, float]:
        """Clone the winners of all comparisons, from the reference."""
        if self.config.source == "episodes":
            return {}
        self.start_again()
        winners = [pairs.left[pairs.target == 1], pairs.right[pairs.target == 0]]
        steps = torch.cat(winners).flatten(0, 1)
        return self._clone(*steps.split(self._widths, -1))

    def extra_state(self, buffer: bool = True) -> dict[str, Any]:
        """Return the stored steps."""
        return self._replay.state(buffer)

    def load_extra_state(self, state: dict[str, Any]) -> None:
        """Restore what `extra_state` returned.

        Raises:
            ValueError: it is of another buffer, or damaged.
        """
        self._replay.load_state(state)

    def _new_replay(self) -> Replay:
        return Replay(self.config.buffer_size, *self._widths)

    def _clone(self, observation: Tensor, action: Tensor) -> dict[str, float]:
        """Maximise the likelihood of actions [B, A] in states [B, D]."""
        loss = 0.0
        for _ in range(self.config.epochs):
            order = torch.randperm(len(observation))
            for rows in order.split(self.config.batch_size):
                loss = self._learn(observation[rows], action[rows])
        return {"loss_actor": loss}

    def _learn(self, observation: Tensor, action: Tensor) -> float:
        policy = IndependentNormal(*self.gaussian(observation))
        loss = -policy.log_prob(action).mean()
        descend(self._optim, loss)
        return loss.item()


def best_steps(steps: TensorDictBase, fraction: float) -> TensorDictBase:
    """The steps of the best episodes among steps [S, 1] (see `Replay.steps`).

    Args:
        fraction: of the episodes that ended; at least one of them.

    Returns:
        [B] steps of the episodes with the highest mean reward.
    """
    steps = steps.squeeze(-1)
    names, number = steps["episode"].unique(return_inverse=True)
    reward, ended = (
        steps["next", "reward"].squeeze(-1),
        steps["next", "done"].squeeze(-1),
    )
    count = torch.zeros(len(names)).index_add_(0, number, torch.ones_like(reward))
    mean = torch.zeros(len(names)).index_add_(0, number, reward) / count
    whole = torch.zeros(len(names), dtype=torch.bool)
    whole[number[ended]] = True
    mean[~whole] = -torch.inf
    chosen = mean.topk(max(1, round(fraction * int(whole.sum())))).indices
    best: TensorDictBase = steps[torch.isin(number, chosen)]
    return best
