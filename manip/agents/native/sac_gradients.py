"""Gradients of SAC's losses: by TorchRL and autograd, and the same in native code."""

import warnings
from collections.abc import Mapping
from functools import partial
from typing import Any, NamedTuple, Protocol

import torch
from torch import Tensor, nn
from torchrl.objectives import SACLoss

from manip.agents.flat_parameters import flatten, zero_gradient
from manip.agents.native.gradient_check import (
    GradientCheck,
    GradientSource,
    perturbed,
)
from manip.agents.native.gradient_probes import sac_probe
from manip.agents.native.mlp_kernels import NORM_RELU, RELU, layout_of
from manip.agents.native.row_blocks import BLOCK_ROWS, RowBlocks, count_blocks
from manip.agents.native.sac_kernels import (
    Nets,
    Work,
    actor_gradients,
    critic_gradients,
    work_for,
)
from manip.agents.networks import Actor, widths_of
from manip.agents.off_policy import transitions_of

# SAC._learn moves the targets itself, without torchrl's updater; the parameters'
# gradients are views of flat ones, with strides of their own.
warnings.filterwarnings("ignore", "No target network updater")
warnings.filterwarnings("ignore", "grad and param do not obey")


class FlatParams(NamedTuple):
    """SACLoss's parameters, flat: actor and log(temperature) [P + 1], critics [C, Q].

    gradients: name -> gradient of each parameter of each network, a view of the flat
    ones.
    """

    actor: nn.Parameter
    critics: nn.Parameter
    targets: nn.Parameter
    gradients: Mapping[str, Tensor]

    def gradient_of_alpha(self) -> Tensor:
        """The entry of the gradient by log(temperature)."""
        return self.gradients["log_alpha"]


class Gradients(Protocol):
    """Writes the gradients of a batch of rows (see `rows_of`) to the parameters."""

    def critic(self, rows: Any) -> float:
        """Write the critics' gradients; return the sum of their losses."""

    def actor(self, rows: Any) -> tuple[float, float]:
        """Write the actor's and the temperature's gradients.

        Returns:
            The actor's loss and the mean of log pi(a | s).
        """


def flatten_loss(loss: SACLoss, actor: nn.Module) -> FlatParams:
    """Make the loss's parameters views of flat ones."""
    layers = [
        ("module", name, kind)
        for name, layer in loss.qvalue_network.module.named_children()
        for kind, _ in layer.named_parameters()
    ]
    online, target = loss.qvalue_network_params, loss.target_qvalue_network_params
    actor_params = dict(actor.named_parameters()) | {"log_alpha": loss.log_alpha}
    critic_params = {".".join(layer[1:]): online.get(layer) for layer in layers}
    flat_actor = flatten([*actor_params.values()])
    flat_critics = flatten([*critic_params.values()], leading=1)
    flat_targets = flatten([target.get(layer) for layer in layers], leading=1)
    gradients = {name: param.grad for name, param in actor_params.items()} | {
        f"critic {index} {name}": param.grad[index]
        for name, param in critic_params.items()
        for index in range(len(flat_critics))
    }
    return FlatParams(flat_actor, flat_critics, flat_targets, gradients)


def sac_gradients(
    loss: SACLoss,
    params: FlatParams,
    actor: Actor,
    gamma: float,
    batch: int,
    threads: int,
    source: GradientSource,
) -> Gradients:
    """Return checked native gradients, or TorchRL's if `source` is "torchrl".

    There are none in native code on other devices than the CPU.
    """
    reference = AutogradGradients(loss, params, actor.observation_dim)
    if source == "torchrl" or params.actor.device.type != "cpu":
        return reference
    nets = _nets(loss, params, actor, gamma)
    native = NativeGradients(nets, params, batch, threads)
    return CheckedGradients(native, reference, params, actor, batch)


def _nets(loss: SACLoss, params: FlatParams, actor: Actor, gamma: float) -> Nets:
    critic = loss.qvalue_network.module
    return Nets(
        actor=params.actor.data.numpy(),
        critics=params.critics.data.numpy(),
        targets=params.targets.data.numpy(),
        actor_layout=layout_of(widths_of(actor.body), RELU, BLOCK_ROWS),
        critic_layout=layout_of(widths_of(critic), NORM_RELU, BLOCK_ROWS),
        action_scale=actor.action_scale.numpy(),
        gamma=gamma,
        target_entropy=float(loss.target_entropy),
    )


class AutogradGradients:
    """TorchRL's SACLoss and PyTorch's autograd."""

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
        loss, outputs = self._loss.actor_loss(transitions_of(rows, self._states))
        log_prob = outputs["log_prob"]
        (loss + self._loss.alpha_loss(log_prob).mean()).backward()
        return loss.item(), log_prob.mean().item()


class NativeGradients:
    """The same in native code; the number of threads does not change a bit."""

    def __init__(self, nets: Nets, params: FlatParams, batch: int, threads: int):
        self._nets, self._params = nets, params
        work = work_for(nets, count_blocks(batch), BLOCK_ROWS)
        self._sums = work.sums
        self._d_actor = torch.from_numpy(work.d_actor)
        self._d_critics = torch.from_numpy(work.d_critics)
        workspaces = [Work(*arrays) for arrays in zip(*work, strict=True)]
        self._blocks = RowBlocks(workspaces, threads)

    def critic(self, rows: Tensor) -> float:
        """See `Gradients`."""
        self._blocks.run(critic_gradients, self._nets, rows, self._noise(len(rows)))
        grad = torch.sum(self._d_critics, 0, out=self._params.critics.grad)
        grad.div_(len(rows))
        return float(self._sums[:, 0].sum()) / len(rows)

    def actor(self, rows: Tensor) -> tuple[float, float]:
        """See `Gradients`."""
        self._blocks.run(actor_gradients, self._nets, rows, self._noise(len(rows)))
        grad = torch.sum(self._d_actor, 0, out=self._params.actor.grad)
        grad.div_(len(rows))
        loss, log_prob = self._sums.sum(0) / len(rows)
        return float(loss), float(log_prob)

    def _noise(self, rows: int) -> Tensor:
        return torch.randn(rows, len(self._nets.action_scale))


class CheckedGradients(GradientCheck[Gradients]):
    """Native gradients while they agree with TorchRL's."""

    def __init__(
        self,
        native: Gradients,
        reference: Gradients,
        params: FlatParams,
        actor: Actor,
        batch: int,
    ) -> None:
        super().__init__(native, reference)
        self._params = params
        probe = partial(sac_probe, actor, batch)
        with perturbed([flat.data for flat in params[:3]]):
            agree = self._agree_on_probe(probe)
            for critics in (params.critics.data, params.targets.data):
                critics.copy_(critics.flip(0))  # one critic may be the lowest always
            agree = agree and self._agree_on_probe(probe)
        if not agree:
            self._fall_back()

    def critic(self, rows: Tensor) -> float:
        """See `Gradients`."""
        return self._select(rows).critic(rows)

    def actor(self, rows: Tensor) -> tuple[float, float]:
        """See `Gradients`."""
        return self.in_use.actor(rows)

    def _measure(self, gradients: Gradients, rows: Tensor) -> dict[str, Tensor]:
        numbers = [gradients.critic(rows), *gradients.actor(rows)]
        names = ("loss_critic", "loss_actor", "log_prob")
        reported = dict(zip(names, map(torch.tensor, numbers), strict=True))
        return reported | {k: v.clone() for k, v in self._params.gradients.items()}
