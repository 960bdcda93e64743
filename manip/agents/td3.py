"""Twin delayed DDPG (Fujimoto et al. 2018, arXiv 1802.09477), with TorchRL's TD3Loss.

    critics: min (Q_i(s, a) - y)^2,
             y = r + gamma r' + ... + gamma^n (1 - terminated) min_i Q'_i(s', a'),
             a' = clip(mu'(s') + clip(sigma' noise, -c, c), -1, 1)
    actor:   max Q_1(s, mu(s)), once in `actor_delay` critic updates

s' is the state n steps later; Q' and mu' are exponential averages of Q and mu, updated
with the actor. Exploration is mu(s) + sigma noise. The networks see actions in units of
action_scale. A time limit is no termination: y bootstraps from the true last
observation. For n > 1 the rewards between s and s' are older policies' (off-policy
bias, not corrected). With one critic, no delay and no target noise this is DDPG
(Lillicrap et al. 2015, arXiv 1509.02971).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Annotated

import torch
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import Generator, Tensor, nn
from torch.optim import Adam
from torchrl.objectives import SoftUpdate, TD3Loss

from manip.agents.agent import Spaces
from manip.agents.exploration import RolloutPolicy
from manip.agents.networks import Actor
from manip.agents.off_policy import (
    OffPolicy,
    OffPolicyConfig,
    descend,
    make_critics,
    transitions_of,
)
from manip.io.option_ranges import COUNT, NUMBER, WHOLE


@dataclass(frozen=True)
class TD3Config(OffPolicyConfig):
    """Options of TD3; defaults suit manipulation at 20 Hz, rewards in [0, 1]."""

    actor_hidden: Annotated[tuple[int, ...], COUNT] = (128, 128)
    """Widths of the actor's hidden layers."""
    actor_delay: Annotated[int, COUNT] = 2
    """Critic updates for each update of the actor and of the targets."""
    critic_steps: Annotated[int, WHOLE] = 0
    """Control steps, after the random ones, in which only the critics learn (critic
    warm-up): an actor that starts from a policy keeps it until they are of use."""
    critics: Annotated[int, COUNT] = 2
    """Number of critics; targets use the lowest value."""
    exploration_noise: Annotated[float, NUMBER] = 0.2
    """sigma, standard deviation of the noise while exploring."""
    target_noise: Annotated[float, NUMBER] = 0.2
    """sigma', standard deviation of the noise in targets (policy smoothing)."""
    target_noise_clip: Annotated[float, NUMBER] = 0.5
    """c, largest noise in targets."""


class TD3(OffPolicy):
    """TD3; see the module's docstring."""

    name = "td3"
    Config = TD3Config
    actor: Actor

    def __init__(self, config: TD3Config, spaces: Spaces, threads: int = 1) -> None:
        super().__init__(config, spaces)
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
        """Return uniform actions at first, later the actor's with noise."""
        explore = partial(_noisy, noise=self.config.exploration_noise)
        bursts = self.config.gripper_bursts
        inputs, warm_up = self._spaces.inputs, self.warming_up
        return RolloutPolicy(self.actor, inputs, explore, warm_up, bursts)

    def start_from(self, weights: Mapping[str, Tensor], deviation: float) -> None:
        """See `Agent.start_from`; the target actor starts from them as well."""
        super().start_from(weights, deviation)
        learned = self._loss.actor_network_params.data
        self._loss.target_actor_network_params.data.update_(learned)

    def modules(self) -> dict[str, nn.Module]:
        """Return the loss, which holds actor, critics and targets."""
        return {"loss": self._loss}

    def optimisers(self) -> dict[str, torch.optim.Optimizer]:
        """Return one for the critics, one for the actor."""
        return {"critic": self._critic_optim, "actor": self._actor_optim}

    def _learn(self, rows: Tensor) -> dict[str, float]:
        batch = transitions_of(rows, self.actor.observation_dim)
        batch["action"] = batch["action"] / self.actor.action_scale
        loss, _ = self._loss.value_loss(batch)
        descend(self._critic_optim, loss)
        if self._updates % self.config.actor_delay:
            return {}
        if self._critic_alone(self.config.critic_steps):
            self._targets.step()
            return {"loss_critic": loss.item()}
        actor_loss, _ = self._loss.actor_loss(batch)
        descend(self._actor_optim, actor_loss)
        self._targets.step()
        return {"loss_critic": loss.item(), "loss_actor": actor_loss.item()}


def _noisy(
    actor: Actor, inputs: tuple[Tensor, ...], draw: Generator, noise: float
) -> Tensor:
    mean = actor(*inputs)[0].tanh()
    return (mean + noise * torch.randn(mean.shape, generator=draw)).clamp(-1, 1)


class _Mean(nn.Module):
    """mu(s) = tanh(mean of the actor's Gaussian)."""

    def __init__(self, actor: Actor) -> None:
        super().__init__()
        self.actor = actor

    def forward(self, observation: Tensor) -> Tensor:
        return self.actor(observation)[0].tanh()


def _loss(config: TD3Config, spaces: Spaces, actor: Actor) -> TD3Loss:
    loss = TD3Loss(
        TensorDictModule(_Mean(actor), ["observation"], ["action"]),
        make_critics(config.critics, spaces, config.critic_hidden),
        bounds=(-1.0, 1.0),
        num_qvalue_nets=config.critics,
        policy_noise=config.target_noise,
        noise_clip=config.target_noise_clip,
        loss_function="l2",
    )
    loss.make_value_estimator(gamma=config.gamma)
    return loss
