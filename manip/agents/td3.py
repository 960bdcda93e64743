"""Twin delayed DDPG (Fujimoto et al. 2018, arXiv 1802.09477), on TorchRL's TD3Loss.

    critics: min (Q_i(s, a) - y)^2,
             y = r + gamma r' + ... + gamma^n (1 - terminated) min_i Q'_i(s', a'),
             a' = clip(mu'(s') + clip(sigma' noise, -c, c), -1, 1)
    actor:   max Q_1(s, mu(s)), once in `actor_delay` critic updates

s' is n steps on; Q' and mu' are exponential averages of Q and mu, moved along with the
actor. Exploration is mu(s) + sigma noise. Actions count in units of action_scale. A
time limit is no termination: y bootstraps through it. With one critic, no delay and no
target noise this is DDPG (Lillicrap et al. 2015, arXiv 1509.02971).
"""

from dataclasses import dataclass
from functools import partial

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import Generator, Tensor, nn
from torch.optim import Adam
from torchrl.objectives import SoftUpdate, TD3Loss

from manip.agents.agent import Spaces
from manip.agents.networks import Actor
from manip.agents.off_policy import (
    OffPolicy,
    OffPolicyConfig,
    RolloutPolicy,
    critics_of,
    descend,
    transitions_of,
)


@dataclass(frozen=True)
class TD3Config(OffPolicyConfig):
    """Options of TD3; defaults suit manipulation at 20 Hz, rewards in [0, 1]."""

    actor_hidden: tuple[int, ...] = (128, 128)
    """Widths of the actor's hidden layers."""
    actor_delay: int = 2
    """Critic updates for each update of the actor and of the targets."""
    critics: int = 2
    """How many critics there are; targets take the least of their values."""
    exploration_noise: float = 0.2
    """sigma, of the actions that are tried."""
    target_noise: float = 0.2
    """sigma', of the actions that targets value."""
    target_noise_clip: float = 0.5
    """c, the most that a target's action is moved."""


class TD3(OffPolicy):
    """TD3 on TorchRL; see the module's docstring."""

    actor: Actor

    def __init__(self, config: TD3Config, spaces: Spaces, threads: int = 1) -> None:
        super().__init__(config)
        self.config = config
        self.actor = Actor(
            spaces.observation_dim,
            spaces.action_dim,
            config.actor_hidden,
            squash=True,
            normalise=False,
            action_scale=config.action_scale,
        )
        self._loss = _loss(config, spaces, self.actor)
        self._targets = SoftUpdate(self._loss, tau=config.tau)
        self._actor_optim, self._critic_optim = (
            Adam(params.values(True, True), config.learning_rate, fused=True)
            for params in (
                self._loss.actor_network_params,
                self._loss.qvalue_network_params,
            )
        )

    def policy(self) -> TensorDictModuleBase:
        """Uniform at first, then the actor's actions and noise."""
        explore = partial(_noisy, noise=self.config.exploration_noise)
        bursts = self.config.gripper_bursts
        return RolloutPolicy(self.actor, explore, self.warming_up, bursts)

    def update(self, batch: TensorDictBase) -> dict[str, float]:
        """See `OffPolicy`; the critics see actions in units of action_scale."""
        unit = batch["action"] / self.actor.action_scale
        return super().update(batch.copy().set("action", unit))

    def modules(self) -> dict[str, nn.Module]:
        """The loss holds actor, critics and targets."""
        return {"loss": self._loss}

    def optimisers(self) -> dict[str, torch.optim.Optimizer]:
        """One for the critics, one for the actor."""
        return {"critic": self._critic_optim, "actor": self._actor_optim}

    def _learn(self, rows: Tensor) -> dict[str, float]:
        batch = transitions_of(rows, self.actor.observation_dim)
        loss, _ = self._loss.value_loss(batch)
        descend(self._critic_optim, loss)
        if self._updates % self.config.actor_delay:
            return {}
        aim, _ = self._loss.actor_loss(batch)
        descend(self._actor_optim, aim)
        self._targets.step()
        return {"loss_critic": loss.item(), "loss_actor": aim.item()}


def _noisy(actor: Actor, observation: Tensor, draw: Generator, noise: float) -> Tensor:
    mean = actor(observation)[0].tanh()
    return (mean + noise * torch.randn(mean.shape, generator=draw)).clamp(-1, 1)


class _Mean(nn.Module):
    """mu(s): where tanh puts the mean of an actor's Gaussian."""

    def __init__(self, actor: Actor) -> None:
        super().__init__()
        self.actor = actor

    def forward(self, observation: Tensor) -> Tensor:
        return self.actor(observation)[0].tanh()


def _loss(config: TD3Config, spaces: Spaces, actor: Actor) -> TD3Loss:
    loss = TD3Loss(
        TensorDictModule(_Mean(actor), ["observation"], ["action"]),
        critics_of(config.critics, spaces, config.critic_hidden),
        bounds=(-1.0, 1.0),
        num_qvalue_nets=config.critics,
        policy_noise=config.target_noise,
        noise_clip=config.target_noise_clip,
        loss_function="l2",
    )
    loss.make_value_estimator(gamma=config.gamma)
    return loss
