"""Gradients of SAC's losses: as TorchRL defines them, and the same in native code."""

import warnings
from typing import NamedTuple, Protocol

import torch
from torch import Tensor, nn
from torchrl.objectives import SACLoss

from manip.agents.flat_parameters import flatten, zero_gradient
from manip.agents.native.gradient_check import native_if_right
from manip.agents.native.mlp_kernels import NORM_RELU, RELU, layout_of
from manip.agents.native.row_blocks import PART, Parts, parts_of
from manip.agents.native.sac_kernels import (
    Nets,
    Work,
    actor_gradients,
    critic_gradients,
    work_for,
)
from manip.agents.networks import Actor, widths_of
from manip.agents.off_policy import transitions_of

# The targets are moved by one call in SAC._learn, not by torchrl's updater; gradients
# are views of flat ones.
warnings.filterwarnings("ignore", "No target network updater")
warnings.filterwarnings("ignore", "grad and param do not obey")


class FlatParams(NamedTuple):
    """SACLoss's parameters, flat: actor and temperature [P + 1], critics [C, Q]."""

    actor: nn.Parameter
    critics: nn.Parameter
    targets: nn.Parameter

    def gradient(self) -> Tensor:
        """A copy of both gradients in one row."""
        found = (self.actor.grad, self.critics.grad)
        return torch.cat([grad.flatten() for grad in found if grad is not None])

    def gradient_of_alpha(self) -> Tensor:
        """The place of the gradient by log(temperature)."""
        assert self.actor.grad is not None
        return self.actor.grad[-1]


class Gradients(Protocol):
    """Writes the gradients of a batch of rows (see `rows_of`) to the parameters."""

    def critic(self, rows: Tensor) -> float:
        """Of both critics; returns their loss."""

    def actor(self, rows: Tensor) -> tuple[float, float]:
        """Of actor and temperature; returns the actor's loss and mean log pi(a | s)."""


def flatten_loss(loss: SACLoss, actor: Actor) -> FlatParams:
    """Make the loss's parameters views of flat ones."""
    layers = [
        ("module", name, kind)
        for name, layer in loss.qvalue_network.module.named_children()
        for kind, _ in layer.named_parameters()
    ]
    online, target = loss.qvalue_network_params, loss.target_qvalue_network_params
    return FlatParams(
        flatten([*actor.body.parameters(), loss.log_alpha]),
        flatten([online.get(key) for key in layers], leading=1),
        flatten([target.get(key) for key in layers], leading=1),
    )


def sac_gradients(
    loss: SACLoss,
    params: FlatParams,
    actor: Actor,
    gamma: float,
    batch: int,
    threads: int,
) -> Gradients:
    """Native gradients where they agree with autograd's, autograd's elsewhere."""
    defined: Gradients = AutogradGradients(loss, params, actor.observation_dim)
    native: Gradients = NativeGradients(
        _nets(loss, params, actor, gamma), params, batch, threads
    )
    states, actions = actor.observation_dim, len(actor.action_scale)
    with torch.random.fork_rng():
        rows = torch.randn(batch, 2 * states + actions + 3)
    rows[:, states : states + actions].tanh_()
    rows[:, -2:] = torch.tensor([1.0, 0.0])

    def probe(gradients: Gradients) -> Tensor:
        gradients.critic(rows)
        gradients.actor(rows)
        return params.gradient()

    return native_if_right(native, defined, probe)


def _nets(loss: SACLoss, params: FlatParams, actor: Actor, gamma: float) -> Nets:
    critic = loss.qvalue_network.module
    return Nets(
        actor=params.actor.data.numpy(),
        critics=params.critics.data.numpy(),
        targets=params.targets.data.numpy(),
        actor_layout=layout_of(widths_of(actor.body), RELU, PART),
        critic_layout=layout_of(widths_of(critic), NORM_RELU, PART),
        action_scale=actor.action_scale.numpy(),
        gamma=gamma,
        target_entropy=float(loss.target_entropy),
    )


class AutogradGradients:
    """TorchRL's SACLoss and PyTorch's autograd: the definition."""

    def __init__(self, loss: SACLoss, params: FlatParams, states: int) -> None:
        self._loss, self._params = loss, params
        self._states = states

    def critic(self, rows: Tensor) -> float:
        """See `Gradients`."""
        zero_gradient(self._params.critics)
        loss, _ = self._loss.qvalue_v2_loss(transitions_of(rows, self._states))
        loss.backward()
        return loss.item()

    def actor(self, rows: Tensor) -> tuple[float, float]:
        """See `Gradients`."""
        zero_gradient(self._params.actor)
        loss, found = self._loss.actor_loss(transitions_of(rows, self._states))
        log_prob = found["log_prob"]
        (loss + self._loss.alpha_loss(log_prob).mean()).backward()
        return loss.item(), log_prob.mean().item()


class NativeGradients:
    """The same in native code, on several threads, whatever their number."""

    def __init__(self, nets: Nets, params: FlatParams, batch: int, threads: int):
        self._nets, self._params = nets, params
        work = work_for(nets, parts_of(batch), PART)
        self._found = work.found
        self._d_actor = torch.from_numpy(work.d_actor)
        self._d_critics = torch.from_numpy(work.d_critics)
        scratch = [Work(*arrays) for arrays in zip(*work, strict=True)]
        self._parts = Parts(scratch, threads)

    def critic(self, rows: Tensor) -> float:
        """See `Gradients`."""
        self._parts.run(critic_gradients, self._nets, rows, self._noise(len(rows)))
        grad = torch.sum(self._d_critics, 0, out=self._params.critics.grad)
        grad.div_(len(rows))
        return float(self._found[:, 0].sum()) / len(rows)

    def actor(self, rows: Tensor) -> tuple[float, float]:
        """See `Gradients`."""
        self._parts.run(actor_gradients, self._nets, rows, self._noise(len(rows)))
        grad = torch.sum(self._d_actor, 0, out=self._params.actor.grad)
        grad.div_(len(rows))
        loss, log_prob = self._found.sum(0) / len(rows)
        return float(loss), float(log_prob)

    def _noise(self, rows: int) -> Tensor:
        return torch.randn(rows, len(self._nets.action_scale))
