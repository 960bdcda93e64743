"""Base of the algorithms that learn from the latest rollout of their own policy."""

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import Tensor, nn
from torchrl.modules import IndependentNormal, ProbabilisticActor, ValueOperator
from torchrl.objectives import LossModule

from manip.agents.agent import Agent, Spaces
from manip.agents.bounded_gaussian import BoundedGaussian
from manip.agents.flat_parameters import flatten, zero_gradient
from manip.agents.gaussian_actor import GaussianActorConfig, make_gaussian
from manip.agents.networks import (
    Actor,
    RunningNorm,
    mlp,
    orthogonal,
    seeded_generator,
)
from manip.agents.trajectory import CPU, placed
from manip.agents.value_targets import add_values
from manip.io.option_ranges import COUNT, NUMBER, POSITIVE, SHARE, WHOLE

Samples = TypeVar("Samples", Tensor, TensorDictBase)


@dataclass(frozen=True)
class OnPolicyConfig(GaussianActorConfig):
    """Options of all on-policy algorithms; defaults suit manipulation at 20 Hz."""

    gamma: Annotated[float, SHARE] = 0.97
    """Discount factor per control step: larger counts later rewards more."""
    learning_rate: Annotated[float, NUMBER] = 5e-4
    """Adam's step size."""
    rollout_length: Annotated[int, COUNT] = 32
    """Control steps of each environment between two updates (n_steps)."""
    critic_coefficient: Annotated[float, POSITIVE] = 0.5
    """c_V, weight of the critic's loss (value coefficient)."""
    max_gradient: Annotated[float, NUMBER] = 1.0
    """Largest norm of a gradient; longer ones are scaled down (max_grad_norm)."""
    critic_hidden: Annotated[tuple[int, ...], COUNT] = (128, 128)
    """Widths of the critic's hidden layers."""
    critic_rollouts: Annotated[int, WHOLE] = 0
    """First rollouts from which only the critic learns (critic warm-up)."""


class RolloutPolicy(TensorDictModuleBase):
    """Sample a copy of the actor, and record each action's log-probability."""

    in_keys = ["observation"]
    out_keys = ["action", "action_log_prob"]

    def __init__(self, actor: Actor | BoundedGaussian) -> None:
        super().__init__()
        self._actor, self._device = deepcopy(actor), actor.action_scale.device
        self._generator = seeded_generator(self._device)

    @torch.no_grad()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write `action` [N, A] and `action_log_prob` [N]."""
        observation = tensordict["observation"]
        loc, scale = self._actor(observation.to(self._device))
        noise = torch.randn(loc.shape, generator=self._generator, device=loc.device)
        action = loc + scale * noise
        log_prob = IndependentNormal(loc, scale).log_prob(action)
        tensordict.set("action_log_prob", log_prob.to(observation.device))
        return tensordict.set("action", action.to(observation.device))


class OnPolicy(Agent):
    """Learn from each rollout after it was collected, then discard it.

    A Gaussian actor, a critic, and one Adam for one flat parameter that holds those of
    the actor's network, its log standard deviations, and the critic's, in this order.

    Args:
        device: where networks, optimiser and updates are.

    Attributes:
        gaussian: distribution of the actions: the actor, or around a bounded actor.
    """

    actor: Actor

    def __init__(
        self, config: OnPolicyConfig, spaces: Spaces, device: torch.device = CPU
    ) -> None:
        self.rollout_length, self._device = config.rollout_length, device
        self._critic_rollouts, self._rollouts = config.critic_rollouts, 0
        self.actor, self.gaussian = make_gaussian(config, spaces)
        self.gaussian.to(device)
        self.critic = _critic(config, spaces, self.actor.norm).to(device)
        self.stochastic = ProbabilisticActor(
            TensorDictModule(self.gaussian, ["observation"], ["loc", "scale"]),
            in_keys=["loc", "scale"],
            distribution_class=IndependentNormal,
            return_log_prob=True,
        )
        self._loss = self._make_loss()
        self._max_gradient = config.max_gradient
        actor = [*self.actor.body.parameters(), self.gaussian.log_std]
        self._actor_size = sum(param.numel() for param in actor)
        self._params = flatten([*actor, *self.critic.parameters()])
        self._optim = torch.optim.Adam(
            [self._params], config.learning_rate, eps=1e-5, fused=True
        )

    def policy(self) -> TensorDictModuleBase:
        """Return samples of the actor, with log-probabilities."""
        return RolloutPolicy(self.gaussian)

    def update(self, batch: TensorDictBase) -> dict[str, float]:
        """Add the critic's values to the rollout [N, T] and learn from it."""
        batch = placed(batch, self._device)
        logged = self._learn(add_values(batch, self.critic))
        self._finish(batch["observation"])
        return logged

    def start_from(self, weights: Mapping[str, Tensor], deviation: float) -> None:
        """See `Agent.start_from`."""
        super().start_from(weights, deviation)
        self.gaussian.log_std.data.fill_(math.log(deviation))

    def extra_state(self, buffer: bool = True) -> dict[str, Any]:
        """Return the number of rollouts, if the critic learns alone at first."""
        return {"rollouts": self._rollouts} if self._critic_rollouts else {}

    def load_extra_state(self, state: dict[str, Any]) -> None:
        """Restore what `extra_state` returned.

        Raises:
            ValueError: the number of rollouts is negative.
        """
        self._rollouts = int(state.get("rollouts", 0))
        if self._rollouts < 0:
            raise ValueError("the checkpoint's number of rollouts is negative")

    def modules(self) -> dict[str, nn.Module]:
        """Return the loss, which holds actor and critic."""
        return {"loss": self._loss}

    def optimisers(self) -> dict[str, torch.optim.Optimizer]:
        """Return one for everything."""
        return {"all": self._optim}

    @property
    def gradient(self) -> Tensor:
        """Gradient [P] by all parameters, which the next step uses."""
        assert self._params.grad is not None
        return self._params.grad

    @abstractmethod
    def _make_loss(self) -> LossModule:
        """Build the loss of `self.stochastic` and `self.critic`."""

    @abstractmethod
    def _learn(self, batch: TensorDictBase) -> dict[str, float]:
        """Learn from a rollout [N, T] that has `state_value`, now and next."""

    @torch.no_grad()
    def _add_distribution(self, samples: TensorDictBase) -> TensorDictBase:
        """Write the present policy's `loc` and `scale`, for a KL divergence later."""
        loc, scale = self.gaussian(samples["observation"])
        return samples.set("loc", loc).set("scale", scale)

    @property
    def _critic_alone(self) -> bool:
        """Whether only the critic learns from the present rollout."""
        return self._rollouts < self._critic_rollouts

    def _finish(self, observation: Tensor) -> None:
        """End the update from a rollout with these observations [N, T, D]."""
        self._rollouts += 1
        self._update_norm(observation)

    def _update_norm(self, observation: Tensor) -> None:
        """Add observations [N, T, D] to the running statistics, if there are any."""
        if isinstance(self.actor.norm, RunningNorm):
            self.actor.norm.update(observation)

    def _differentiate(self, loss: Tensor) -> None:
        """Write the loss's gradient, computed by autograd, to `gradient`."""
        zero_gradient(self._params)
        loss.backward()

    def _descend(self, loss: Tensor) -> None:
        """Step down the loss's gradient."""
        self._differentiate(loss)
        self._step()

    def _step(self) -> None:
        """Step down the present `gradient`, scaled down to the largest norm."""
        if self._critic_alone:
            self.gradient[: self._actor_size].zero_()
        nn.utils.clip_grad_norm_([self._params], self._max_gradient)
        self._optim.step()


def losses(output: TensorDictBase) -> dict[str, Any]:
    """Return the terms of a TorchRL loss, which are to be added up.

    There is no entropy term where its weight is 0.
    """
    return {name: term for name, term in output.items() if name.startswith("loss_")}


def minibatches(samples: Samples, count: int) -> Sequence[Samples]:
    """Shuffle samples [B] and split them into `count` minibatches."""
    shuffled = samples[torch.randperm(len(samples), device=samples.device)]
    return shuffled.split(-(-len(samples) // count))


def _critic(config: OnPolicyConfig, spaces: Spaces, norm: nn.Module) -> ValueOperator:
    body = mlp(spaces.observation_dim, 1, config.critic_hidden, nn.Tanh)
    orthogonal(body, 2**0.5, 1.0)
    return ValueOperator(nn.Sequential(norm, body), in_keys=["observation"])
