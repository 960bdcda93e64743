"""PPO with a KL penalty (Schulman et al. 2017, arXiv 1707.06347, section 4).

    actor:   max E rho A - beta KL(pi_old || pi) + c_H entropy,
             rho = pi(a | s) / pi_old(a | s)
    beta:    doubled after an update whose KL exceeds 1.5 d, halved below d / 1.5
    rewards: r - beta_ref log(pi_old(a | s) / pi_ref(a | s)), if there is a reference

Critic and advantages are PPO's. The reference is a policy that was trained before: the
actor starts from it, and the rewards, which then hold an estimate of KL(pi || pi_ref),
keep it near by: the form used after pre-training (Ziegler et al. 2019, arXiv
1909.08593). TorchRL's KLPENPPOLoss would adapt beta at each minibatch: here it adapts
once an update, as in the paper.
"""

from copy import deepcopy
from dataclasses import dataclass

import torch
from tensordict import TensorDictBase
from torch import nn
from torchrl.modules import IndependentNormal
from torchrl.objectives import KLPENPPOLoss
from torchrl.objectives.value import GAE

from manip.agents.agent import Spaces
from manip.agents.networks import Actor
from manip.agents.on_policy import OnPolicy, OnPolicyConfig, losses, minibatches
from manip.agents.policy import load_policy
from manip.errors import UserError


@dataclass(frozen=True)
class PPOKLConfig(OnPolicyConfig):
    """Options of PPO-KL; defaults suit manipulation at 20 Hz, rewards in [0, 1]."""

    gae_lambda: float = 0.95
    """Decay of the advantage estimate's sum."""
    beta: float = 1.0
    """Weight of the KL penalty, at first."""
    target_kl: float | None = 0.02
    """d, mean KL divergence of an update that beta aims at; beta is fixed if None."""
    reference: str | None = None
    """Run folder of the policy to start from and to stay near (action_scale, too)."""
    reference_beta: float = 0.05
    """beta_ref, weight of the distance to the reference in the rewards."""
    epochs: int = 5
    """Passes over each rollout."""
    minibatches: int = 8
    """Pieces that each pass is split into."""
    entropy_coefficient: float = 0.002
    """c_H, weight of the entropy bonus."""


class PPOKL(OnPolicy):
    """PPO-KL on TorchRL; see the module's docstring."""

    def __init__(self, config: PPOKLConfig, spaces: Spaces, threads: int = 1) -> None:
        self.config = config
        super().__init__(config, spaces)
        self._gae = GAE(gamma=config.gamma, lmbda=config.gae_lambda, value_network=None)
        self._reference = None
        if config.reference is not None:
            self._reference = _reference(config.reference, self.actor)

    def modules(self) -> dict[str, nn.Module]:
        """The reference, too: a run that goes on keeps it, whatever is there now."""
        kept = {"reference": self._reference} if self._reference else {}
        return super().modules() | kept

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
        """Several epochs on the rollout [N, T]."""
        told = self._charge(batch)
        samples = self._add_distribution(self._gae(batch).reshape(-1))
        for _ in range(self.config.epochs):
            for piece in minibatches(samples, self.config.minibatches):
                told |= self._improve(piece)
        return told | self._adapt(samples)

    @torch.no_grad()
    def _charge(self, batch: TensorDictBase) -> dict[str, float]:
        """Take the distance to the reference off the rewards."""
        if self._reference is None:
            return {}
        policy = IndependentNormal(*self._reference(batch["observation"]))
        apart = batch["action_log_prob"] - policy.log_prob(batch["action"])
        batch["next", "reward"] -= self.config.reference_beta * apart.unsqueeze(-1)
        return {"kl_reference": apart.mean().item()}

    def _improve(self, samples: TensorDictBase) -> dict[str, float]:
        found = losses(self._loss(samples))
        self._descend(sum(found.values()))
        return {name: part.item() for name, part in found.items()}

    @torch.no_grad()
    def _adapt(self, samples: TensorDictBase) -> dict[str, float]:
        """Set beta by how far the whole update has moved the policy."""
        kl, aim = self._loss(samples)["kl"].mean().item(), self.config.target_kl
        if aim is not None and kl > 1.5 * aim:
            self._loss.beta.mul_(2)
        if aim is not None and kl < aim / 1.5:
            self._loss.beta.div_(2)
        return {"kl": kl, "beta": self._loss.beta.item()}


def _reference(folder: str, actor: Actor) -> Actor:
    """The actor of a trained policy, whose weights `actor` gets, too."""
    found = load_policy(folder).actor
    try:
        actor.load_state_dict(found.state_dict())
    except RuntimeError as error:
        raise UserError(
            f"the policy in {folder} has other networks than this run: it must come "
            "from an algorithm with PPO's kind of actor, of equal task and actor_hidden"
        ) from error
    return deepcopy(actor)
