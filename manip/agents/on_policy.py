"""What the algorithms share that learn from their own policy's latest rollout."""

from abc import abstractmethod
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any, TypeVar

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import Tensor, nn
from torchrl.modules import IndependentNormal, ProbabilisticActor, ValueOperator
from torchrl.objectives import LossModule

from manip.agents.agent import Agent, Spaces
from manip.agents.flat_parameters import flatten, zero_gradient
from manip.agents.networks import Actor, RunningNorm, mlp, orthogonal, seeded
from manip.agents.value_targets import add_values

Samples = TypeVar("Samples", Tensor, TensorDictBase)


@dataclass(frozen=True)
class OnPolicyConfig:
    """Options that all of them have; defaults suit manipulation at 20 Hz."""

    gamma: float = 0.97
    """Discount a control step."""
    learning_rate: float = 5e-4
    """Adam's step size."""
    rollout_length: int = 32
    """Control steps of every world between two updates."""
    critic_coefficient: float = 0.5
    """c_V, weight of the critic's loss."""
    max_gradient: float = 1.0
    """Gradients are scaled down to this norm."""
    actor_hidden: tuple[int, ...] = (128, 128)
    """Widths of the actor's hidden layers."""
    critic_hidden: tuple[int, ...] = (128, 128)
    """Widths of the critic's hidden layers."""
    normalise: bool = True
    """Normalise observations by running statistics, saved with the policy."""
    action_scale: tuple[float, ...] = ()
    """Part of each OSC_POSE action's range used at first; all of it unless given."""


class RolloutPolicy(TensorDictModuleBase):
    """Samples a copy of the actor; writes the action and its log-probability."""

    in_keys = ["observation"]
    out_keys = ["action", "action_log_prob"]

    def __init__(self, actor: Actor) -> None:
        super().__init__()
        self._actor, self._generator = deepcopy(actor), seeded()

    @torch.no_grad()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write `action` [N, A] and `action_log_prob` [N]."""
        loc, scale = self._actor(tensordict["observation"])
        noise = torch.randn(loc.shape, generator=self._generator)
        action = loc + scale * noise
        log_prob = IndependentNormal(loc, scale).log_prob(action)
        return tensordict.set("action_log_prob", log_prob).set("action", action)


class OnPolicy(Agent):
    """Collect with the policy, estimate advantages, learn, forget.

    A Gaussian actor, a critic, and one Adam for the parameters of both, which lie in
    one piece: the actor's, its log deviations, the critic's.
    """

    actor: Actor

    def __init__(self, config: OnPolicyConfig, spaces: Spaces) -> None:
        self.rollout_length = config.rollout_length
        self.actor = Actor(
            spaces.observation_dim,
            spaces.action_dim,
            config.actor_hidden,
            squash=False,
            normalise=config.normalise,
            action_scale=config.action_scale,
        )
        self.critic = _critic(config, spaces, self.actor.norm)
        self.stochastic = ProbabilisticActor(
            TensorDictModule(self.actor, ["observation"], ["loc", "scale"]),
            in_keys=["loc", "scale"],
            distribution_class=IndependentNormal,
            return_log_prob=True,
        )
        self._loss = self._make_loss()
        self._max_gradient = config.max_gradient
        body = self.actor.body.parameters()
        self._params = flatten([*body, self.actor.log_std, *self.critic.parameters()])
        self._optim = torch.optim.Adam(
            [self._params], config.learning_rate, eps=1e-5, fused=True
        )

    def policy(self) -> TensorDictModuleBase:
        """Samples of the actor, with log-probabilities."""
        return RolloutPolicy(self.actor)

    def update(self, batch: TensorDictBase) -> dict[str, float]:
        """Learn from the rollout [N, T] once its steps have their values."""
        told = self._learn(add_values(batch, self.critic))
        self._see(batch["observation"])
        return told

    def modules(self) -> dict[str, nn.Module]:
        """The loss holds actor and critic."""
        return {"loss": self._loss}

    def optimisers(self) -> dict[str, torch.optim.Optimizer]:
        """One for everything."""
        return {"all": self._optim}

    @property
    def gradient(self) -> Tensor:
        """[P], by all parameters: what the next step follows."""
        assert self._params.grad is not None
        return self._params.grad

    @abstractmethod
    def _make_loss(self) -> LossModule:
        """The loss of `self.stochastic` and `self.critic`."""

    @abstractmethod
    def _learn(self, batch: TensorDictBase) -> dict[str, float]:
        """Learn from a rollout [N, T] with `state_value`, now and next."""

    @torch.no_grad()
    def _add_distribution(self, samples: TensorDictBase) -> TensorDictBase:
        """Write `loc` and `scale`, the policy's as it is now, to compare with later."""
        loc, scale = self.actor(samples["observation"])
        return samples.set("loc", loc).set("scale", scale)

    def _see(self, observation: Tensor) -> None:
        """Let the norm know observations [N, T, D]."""
        if isinstance(self.actor.norm, RunningNorm):
            self.actor.norm.update(observation)

    def _differentiate(self, loss: Tensor) -> None:
        """Leave the loss's gradient, as autograd finds it, in `gradient`."""
        zero_gradient(self._params)
        loss.backward()

    def _descend(self, loss: Tensor) -> None:
        """A step down the loss's gradient."""
        self._differentiate(loss)
        self._step()

    def _step(self) -> None:
        """A step down the gradient that the parameters hold."""
        nn.utils.clip_grad_norm_([self._params], self._max_gradient)
        self._optim.step()


def losses(found: TensorDictBase) -> dict[str, Any]:
    """What a loss is the sum of; TorchRL leaves an entropy bonus of weight 0 out."""
    return {name: part for name, part in found.items() if name.startswith("loss_")}


def minibatches(samples: Samples, count: int) -> Sequence[Samples]:
    """Samples [B] shuffled and split into so many pieces."""
    shuffled = samples[torch.randperm(len(samples))]
    return shuffled.split(-(-len(samples) // count))


def _critic(config: OnPolicyConfig, spaces: Spaces, norm: nn.Module) -> ValueOperator:
    body = mlp(spaces.observation_dim, 1, config.critic_hidden, nn.Tanh)
    orthogonal(body, 2**0.5, 1.0)
    return ValueOperator(nn.Sequential(norm, body), in_keys=["observation"])
