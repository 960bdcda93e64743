"""Trust region policy optimisation (Schulman et al. 2015, arXiv 1502.05477).

    actor:     max E rho A  where  E KL(pi_old || pi) <= delta,
               rho = pi(a | s) / pi_old(a | s)
    step:      theta += sqrt(2 delta / (x' F x)) x,  x = F^-1 g by conjugate gradients,
               g the gradient of E rho A, F the Hessian of the mean KL (Fisher matrix)
               plus `damping` on its diagonal; halved until the KL is within delta and
               E rho A has grown
    critic:    min (V(s) - R)^2, by Adam with `learning_rate`
    advantage: GAE(lambda), R = A + V, as in PPO

F is never formed: F v is the gradient of (gradient of KL)' v. TorchRL has no TRPO.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torch.distributions import kl_divergence
from torchrl.objectives import PPOLoss
from torchrl.objectives.value import GAE

from manip.agents.agent import Spaces
from manip.agents.on_policy import OnPolicy, OnPolicyConfig, minibatches
from manip.io.option_ranges import COUNT, NUMBER, SHARE, WHOLE

Product = Callable[[Tensor], Tensor]
"""v [P] -> F v [P]."""


@dataclass(frozen=True)
class TRPOConfig(OnPolicyConfig):
    """Options of TRPO; defaults suit manipulation at 20 Hz, rewards in [0, 1]."""

    gae_lambda: Annotated[float, SHARE] = 0.95
    """lambda of GAE: larger relies more on rewards, less on the critic."""
    max_kl: Annotated[float, NUMBER] = 0.02
    """delta, largest mean KL divergence of an update (trust region)."""
    conjugate_steps: Annotated[int, WHOLE] = 10
    """Iterations of conjugate gradients."""
    damping: Annotated[float, NUMBER] = 0.1
    """Added to the Fisher matrix's diagonal."""
    backtracks: Annotated[int, WHOLE] = 10
    """Most halvings of a step (line search); after them the policy is not changed."""
    epochs: Annotated[int, COUNT] = 5
    """Passes of the critic over each rollout."""
    minibatches: Annotated[int, COUNT] = 8
    """Minibatches per pass of the critic."""


class TRPOLoss(PPOLoss):
    """PPO's objective without clipping, and the KL divergence of a step."""

    def kl(self, samples: TensorDictBase) -> Tensor:
        """Return mean KL(pi_old || pi); samples hold pi_old's `loc` and `scale`."""
        old = self.actor_network.build_dist_from_params(samples)
        state = samples.select(*self.actor_network.in_keys)
        with self.actor_network_params.to_module(self.actor_network):
            return kl_divergence(old, self.actor_network.get_dist(state)).mean()


class TRPO(OnPolicy):
    """TRPO; see the module's docstring."""

    name = "trpo"
    Config = TRPOConfig

    def __init__(self, config: TRPOConfig, spaces: Spaces, threads: int = 1) -> None:
        self.config = config
        super().__init__(config, spaces)
        self._gae = GAE(gamma=config.gamma, lmbda=config.gae_lambda, value_network=None)

    def _make_loss(self) -> TRPOLoss:
        return TRPOLoss(
            self.stochastic,
            self.critic,
            entropy_bonus=False,
            critic_coeff=self.config.critic_coefficient,
            loss_critic_type="l2",
            normalize_advantage=True,
        )

    def _learn(self, batch: TensorDictBase) -> dict[str, float]:
        """Take a step of the actor and several epochs of the critic."""
        samples = self._add_distribution(self._gae(batch).reshape(-1))
        logged = {} if self._critic_alone else self._improve(samples)
        return logged | {"loss_critic": self._fit(samples)}

    def _improve(self, samples: TensorDictBase) -> dict[str, float]:
        loss, fisher = self._objective(samples), self._fisher(samples)
        uphill = -self._gradient(loss)
        x = conjugate_gradients(fisher, uphill, self.config.conjugate_steps)
        step = (2 * self.config.max_kl / (x @ fisher(x))).sqrt() * x
        return self._search(samples, step, loss.item())

    @torch.no_grad()
    def _search(
        self, samples: TensorDictBase, step: Tensor, before: float
    ) -> dict[str, float]:
        """Halve the step until the KL is in bounds and the loss falls (line search)."""
        params = self._params.data[: len(step)]
        start = params.clone()
        for halvings in range(self.config.backtracks + 1):
            params.copy_(start + step * 0.5**halvings)
            loss, kl = self._objective(samples).item(), self._loss.kl(samples).item()
            if loss < before and kl <= self.config.max_kl:
                return {"loss_objective": loss, "kl": kl, "halvings": halvings}
        params.copy_(start)
        return {"loss_objective": before, "kl": 0.0, "halvings": halvings + 1}

    def _fit(self, samples: TensorDictBase) -> float:
        for _ in range(self.config.epochs):
            for piece in minibatches(samples, self.config.minibatches):
                loss = self._loss.loss_critic(piece)[0].mean()
                self._descend(loss)
        return loss.item()

    def _objective(self, samples: TensorDictBase) -> Tensor:
        return self._loss(samples)["loss_objective"]

    def _fisher(self, samples: TensorDictBase) -> Product:
        slope = self._gradient(self._loss.kl(samples), create=True)

        def product(v: Tensor) -> Tensor:
            return self._gradient(slope @ v) + self.config.damping * v

        return product

    def _gradient(self, value: Tensor, create: bool = False) -> Tensor:
        """Return the gradient [P] by the actor's parameters, in their order."""
        params = [*self.actor.body.parameters(), self.gaussian.log_std]
        parts = torch.autograd.grad(
            value, params, retain_graph=True, create_graph=create
        )
        return torch.cat([part.flatten() for part in parts])


def conjugate_gradients(product: Product, b: Tensor, steps: int) -> Tensor:
    """Solve F x = b approximately, F symmetric and positive definite.

    The conjugate gradient method (Hestenes and Stiefel 1952), with residual r = b - F x
    and search direction p: alpha = r'r / (p'F p), x += alpha p, r -= alpha F p.
    """
    x, residual, direction = torch.zeros_like(b), b.clone(), b.clone()
    squared = residual @ residual
    for _ in range(steps):
        product_p = product(direction)
        alpha = squared / (direction @ product_p)
        x += alpha * direction
        residual -= alpha * product_p
        previous, squared = squared, residual @ residual
        if squared < 1e-10:
            break
        direction = residual + squared / previous * direction
    return x
