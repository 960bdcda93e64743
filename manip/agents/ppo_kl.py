"""PPO with a KL penalty (Schulman et al. 2017, arXiv 1707.06347, section 4).

    actor:   max E rho A - beta KL(pi_old || pi) + c_H entropy,
             rho = pi(a | s) / pi_old(a | s)
    beta:    doubled after an update whose KL exceeds 1.5 d, halved below d / 1.5
    rewards: r - beta_ref log(pi_old(a | s) / pi_ref(a | s)), if there is a reference

Critic and advantages are PPO's. The reference is a policy that was trained before. The
actor starts from it, and the rewards penalise an estimate of KL(pi || pi_ref): the form
used after pre-training (Ziegler et al. 2019, arXiv 1909.08593). With a reference, the
observations' statistics stay as they are, as the actor would change with them without
any gradient; and an update ends once its KL exceeds 1.5 d.

TorchRL's KLPENPPOLoss adapts beta after each minibatch; here it is adapted once per
update, as in the paper, and not while only the critic learns.
"""

from copy import deepcopy
from dataclasses import dataclass
from typing import Annotated

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torchrl.modules import IndependentNormal
from torchrl.objectives import KLPENPPOLoss
from torchrl.objectives.value import GAE

from manip.agents.agent import Spaces
from manip.agents.on_policy import OnPolicy, OnPolicyConfig, losses, minibatches
from manip.agents.reference import start_from_reference
from manip.io.option_ranges import COUNT, NUMBER, POSITIVE, SHARE


@dataclass(frozen=True)
class PPOKLConfig(OnPolicyConfig):
    """Options of PPO-KL; defaults suit manipulation at 20 Hz, rewards in [0, 1]."""

    gae_lambda: Annotated[float, SHARE] = 0.95
    """lambda of GAE: larger relies more on rewards, less on the critic."""
    beta: Annotated[float, POSITIVE] = 1.0
    """Weight of the KL penalty at the start."""
    target_kl: Annotated[float | None, POSITIVE] = 0.02
    """d, mean KL divergence of an update that beta is adapted to; None fixes beta."""
    reference: str | None = None
    """Policy to start from and stay close to: a run folder or a shipped name. It sets
    the options of the network."""
    reference_std: Annotated[float, POSITIVE] = 0.1
    """Standard deviation of the actions at the start, as a fraction of their range,
    where the reference gives none: a policy of SAC, TD3 or BC is deterministic. A
    larger value explores more, and fails more often."""
    reference_beta: Annotated[float, NUMBER] = 0.05
    """beta_ref, weight of the divergence from the reference in the rewards: larger
    stays closer."""
    epochs: Annotated[int, COUNT] = 5
    """Passes over each rollout."""
    minibatches: Annotated[int, COUNT] = 8
    """Minibatches per pass."""
    entropy_coefficient: Annotated[float, NUMBER] = 0.002
    """c_H, weight of the entropy bonus."""


class PPOKL(OnPolicy):
    """PPO-KL; see the module's docstring."""

    name = "ppo-kl"
    Config = PPOKLConfig

    def __init__(self, config: PPOKLConfig, spaces: Spaces, threads: int = 1) -> None:
        self.config = config
        super().__init__(config, spaces)
        self._gae = GAE(gamma=config.gamma, lmbda=config.gae_lambda, value_network=None)
        self._reference = None
        if config.reference is not None:
            start_from_reference(self, config.reference, config.reference_std)
            self._reference = deepcopy(self.gaussian)

    def modules(self) -> dict[str, nn.Module]:
        """Return the loss and the reference, so that a resumed run has the same one."""
        reference = {"reference": self._reference} if self._reference else {}
        return super().modules() | reference

    def _make_loss(self) -> KLPENPPOLoss:
        return KLPENPPOLoss(
            self.stochastic,
            self.critic,
            beta=self.config.beta,
            increment=1.0,
            decrement=1.0,
            entropy_coeff=self.config.entropy_coefficient,
            critic_coeff=self.config.critic_coefficient,
            loss_critic_type="l2",
            normalize_advantage=True,
        )

    def _learn(self, batch: TensorDictBase) -> dict[str, float]:
        """Take several epochs of minibatch steps on the rollout [N, T]."""
        logged = self._penalise(batch)
        samples = self._add_distribution(self._gae(batch).reshape(-1))
        for _ in range(self.config.epochs):
            for piece in minibatches(samples, self.config.minibatches):
                logged |= self._improve(piece)
            if self._reference is not None and self._is_far(samples):
                break
        return logged | self._adapt(samples)

    @torch.no_grad()
    def _is_far(self, samples: TensorDictBase) -> bool:
        """Whether the update has gone beyond 1.5 d: with a reference it ends there."""
        target = self.config.target_kl
        kl = self._loss(samples)["kl"].mean().item()
        return target is not None and kl > 1.5 * target

    def _update_norm(self, observation: Tensor) -> None:
        """See `OnPolicy`; nothing where there is a reference."""
        if self._reference is None:
            super()._update_norm(observation)

    @torch.no_grad()
    def _penalise(self, batch: TensorDictBase) -> dict[str, float]:
        """Subtract the divergence from the reference from the rewards."""
        if self._reference is None:
            return {}
        policy = IndependentNormal(*self._reference(batch["observation"]))
        log_ratio = batch["action_log_prob"] - policy.log_prob(batch["action"])
        batch["next", "reward"] -= self.config.reference_beta * log_ratio.unsqueeze(-1)
        return {"kl_reference": log_ratio.mean().item()}

    def _improve(self, samples: TensorDictBase) -> dict[str, float]:
        terms = losses(self._loss(samples))
        self._descend(sum(terms.values()))
        return {name: term.item() for name, term in terms.items()}

    @torch.no_grad()
    def _adapt(self, samples: TensorDictBase) -> dict[str, float]:
        """Adapt beta to the KL divergence of the whole update, if the actor learns."""
        if self._critic_alone:
            return {}
        kl, target = self._loss(samples)["kl"].mean().item(), self.config.target_kl
        if target is not None and kl > 1.5 * target:
            self._loss.beta.mul_(2)
        if target is not None and kl < target / 1.5:
            self._loss.beta.div_(2)
        return {"kl": kl, "beta": self._loss.beta.item()}
