"""Direct preference optimisation (Rafailov et al. 2023, arXiv 2305.18290), on clips.

    max E log sigmoid(alpha (L(better) - L(worse))),
    L(clip) = sum_t log(pi(a_t | s_t) / pi_ref(a_t | s_t))

The policy that is best for a reward with a KL penalty is known up to a constant:
r = alpha log(pi / pi_ref). So comparisons train the policy itself, without a reward
model, and without samples of the new policy. Clips called equal count half each way.
Every round starts again from the reference, with all comparisons so far.
"""

from dataclasses import dataclass
from typing import Annotated

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torchrl.modules import IndependentNormal

from manip.agents.agent import Spaces
from manip.agents.compared_clips import ComparedClips
from manip.agents.off_policy import descend
from manip.agents.reference import FineTuning, FineTuningConfig
from manip.io.option_ranges import COUNT, POSITIVE


@dataclass(frozen=True)
class DPOConfig(FineTuningConfig):
    """Options of DPO; `reference` is needed."""

    alpha: Annotated[float, POSITIVE] = 1.0
    """Weight of the divergence from the reference: larger stays closer."""
    epochs: Annotated[int, COUNT] = 30
    """Passes over the comparisons in each round."""
    batch_size: Annotated[int, COUNT] = 32
    """Comparisons per update (minibatch size)."""


class DPO(FineTuning):
    """DPO; see the module's docstring."""

    name = "dpo"
    Config = DPOConfig

    def __init__(self, config: DPOConfig, spaces: Spaces, threads: int = 1) -> None:
        self.config = config
        super().__init__(config, spaces, threads)

    def update(self, batch: TensorDictBase) -> dict[str, float]:
        """Learn nothing: rollouts only give clips to compare."""
        return {}

    def compare(self, pairs: ComparedClips) -> dict[str, float]:
        """Train the reference anew on all comparisons."""
        self.start_again()
        size, losses = self.config.batch_size, [0.0]
        for _ in range(self.config.epochs):
            order = torch.randperm(len(pairs))
            losses = [self._learn(pairs.at(rows)) for rows in order.split(size)]
        return {"loss_actor": sum(losses) / len(losses)}

    def loss(self, pairs: ComparedClips) -> Tensor:
        """The mean loss of pairs of clips, a scalar."""
        ratios = [self._log_ratio(clips) for clips in (pairs.left, pairs.right)]
        logit = self.config.alpha * (ratios[0] - ratios[1])
        return nn.functional.binary_cross_entropy_with_logits(logit, pairs.target)

    def _log_ratio(self, clips: Tensor) -> Tensor:
        """L [B] of clips [B, L, D + A]."""
        width = self.actor.observation_dim
        observation, action = clips[..., :width], clips[..., width:]
        new = IndependentNormal(*self.gaussian(observation)).log_prob(action)
        with torch.no_grad():
            old = IndependentNormal(*self.reference(observation)).log_prob(action)
        ratio: Tensor = new - old
        return ratio.sum(-1)

    def _learn(self, pairs: ComparedClips) -> float:
        loss = self.loss(pairs)
        descend(self._optim, loss)
        return loss.item()
