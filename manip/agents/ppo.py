"""Proximal policy optimisation (Schulman et al. 2017, arXiv 1707.06347), with TorchRL's
ClipPPOLoss.

    ratio:     rho = pi(a | s) / pi_old(a | s)
    actor:     max E min(rho A, clip(rho, 1 - eps, 1 + eps) A) + c_H entropy
    critic:    min c_V (V(s) - R)^2
    advantage: GAE(lambda): A_t = sum_k (gamma lambda)^k delta_{t+k},
               delta_t = r_t + gamma (1 - terminated) V(s_{t+1}) - V(s_t)

R = A + V. A time limit ends the sum, which then bootstraps from the true last
observation.
"""

from dataclasses import dataclass
from typing import Annotated

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.objectives import ClipPPOLoss, PPOLoss
from torchrl.objectives.value import GAE

from manip.agents.agent import Spaces
from manip.agents.native.gradient_check import GradientSource
from manip.agents.native.ppo_gradients import (
    MinibatchStats,
    gradients_of,
    kl_divergence,
    rows_of,
)
from manip.agents.on_policy import OnPolicy, OnPolicyConfig, minibatches
from manip.agents.trajectory import CPU
from manip.io.option_ranges import COUNT, NUMBER, POSITIVE, SHARE


@dataclass(frozen=True)
class PPOConfig(OnPolicyConfig):
    """Options of PPO; defaults suit manipulation at 20 Hz, rewards in [0, 1]."""

    gae_lambda: Annotated[float, SHARE] = 0.95
    """lambda of GAE: larger relies more on rewards, less on the critic."""
    clip: Annotated[float | None, SHARE] = 0.2
    """eps, range of the probability ratio (clip_range); None does not clip."""
    epochs: Annotated[int, COUNT] = 5
    """Passes over each rollout (n_epochs)."""
    minibatches: Annotated[int, COUNT] = 8
    """Minibatches per pass."""
    entropy_coefficient: Annotated[float, NUMBER] = 0.002
    """c_H, weight of the entropy bonus: larger explores more (ent_coef)."""
    target_kl: Annotated[float | None, POSITIVE] = 0.05
    """Mean KL divergence of a pass after which the update stops; None never stops."""


class PPO(OnPolicy):
    """PPO; see the module's docstring.

    Args:
        gradients: native code, checked against (Clip)PPOLoss, or this and autograd,
            which is the only one on other devices than the CPU.
        device: where networks, rollouts and updates are.
    """

    name = "ppo"
    Config = PPOConfig
    has_native_gradients = True
    takes_device = True

    def __init__(
        self,
        config: PPOConfig,
        spaces: Spaces,
        threads: int = 1,
        gradients: GradientSource = "native",
        device: torch.device = CPU,
    ) -> None:
        self.config = config
        super().__init__(config, spaces, device)
        gae = GAE(gamma=config.gamma, lmbda=config.gae_lambda, value_network=None)
        self._gae = gae.to(device)
        self._gradients = gradients_of(
            self._loss, self.gaussian, self.critic, self._params, threads, gradients
        )

    def _make_loss(self) -> PPOLoss:
        config = self.config
        options = {
            "entropy_coeff": config.entropy_coefficient,
            "critic_coeff": config.critic_coefficient,
            "loss_critic_type": "l2",
            "normalize_advantage": True,
        }
        if config.clip is None:
            return PPOLoss(self.stochastic, self.critic, **options)
        options["clip_epsilon"] = config.clip
        return ClipPPOLoss(self.stochastic, self.critic, **options)

    def _learn(self, batch: TensorDictBase) -> dict[str, float]:
        """Take several epochs of minibatch steps on the rollout [N, T]."""
        rows, pieces = rows_of(self._gae(batch).reshape(-1)), self.config.minibatches
        for _ in range(self.config.epochs):
            stats = [self._improve(piece) for piece in minibatches(rows, pieces)]
            if self._far([minibatch.kl for minibatch in stats]):
                break
        return stats[-1]._asdict() | {"kl": kl_divergence(self.actor, rows)}

    def _far(self, kl: list[float]) -> bool:
        limit = self.config.target_kl
        return limit is not None and sum(kl) / len(kl) > limit

    def _improve(self, rows: Tensor) -> MinibatchStats:
        stats = self._gradients(rows)
        self._step()
        return stats
