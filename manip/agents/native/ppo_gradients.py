"""Gradients of PPO's loss: as TorchRL defines them, and the same in native code."""

import math
from typing import NamedTuple, Protocol

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn
from torchrl.objectives import PPOLoss

from manip.agents.flat_parameters import zero_gradient
from manip.agents.native.gradient_check import native_if_right
from manip.agents.native.mlp_kernels import TANH, layout_of
from manip.agents.native.ppo_kernels import Nets, Work, ppo_gradients, work_for
from manip.agents.native.row_blocks import PART, Parts, parts_of
from manip.agents.networks import Actor, widths_of
from manip.agents.on_policy import losses

MIN_DEVIATION = 1e-6
"""Least standard deviation that advantages are divided by (ClipPPOLoss)."""


ENTROPY = 0.5 * math.log(2 * math.pi * math.e)
"""Entropy [nat] of a normal distribution of deviation 1."""


class Told(NamedTuple):
    """What a minibatch tells; kl is Schulman's estimate of KL(pi_old || pi)."""

    loss_objective: float
    loss_critic: float
    entropy: float
    kl: float
    clip_fraction: float


class Gradients(Protocol):
    """Writes the loss's gradients for a minibatch of rows (see `rows_of`)."""

    def __call__(self, rows: Tensor) -> Told:
        """Writes the gradients to the parameters."""


def rows_of(samples: TensorDictBase) -> Tensor:
    """Samples [B] as rows [B, O + A + 3]: s, a, log pi_old, advantage, value target."""
    parts = [
        samples["observation"],
        samples["action"],
        samples["action_log_prob"].unsqueeze(-1),
        samples["advantage"],
        samples["value_target"],
    ]
    return torch.cat(parts, -1)


def gradients_of(
    loss: PPOLoss,
    actor: Actor,
    critic: nn.Module,
    params: nn.Parameter,
    threads: int,
) -> Gradients:
    """Native gradients where they agree with autograd's, autograd's elsewhere."""
    defined: Gradients = AutogradGradients(loss, actor, params)
    native: Gradients = NativeGradients(loss, actor, critic, params, threads)
    width = actor.observation_dim + len(actor.action_scale) + 3
    with torch.random.fork_rng():
        rows = torch.randn(2 * PART + 1, width)

    def probe(gradients: Gradients) -> Tensor:
        gradients(rows)
        assert params.grad is not None
        return params.grad.clone()

    return native_if_right(native, defined, probe)


class AutogradGradients:
    """TorchRL's (Clip)PPOLoss and PyTorch's autograd: the definition."""

    def __init__(self, loss: PPOLoss, actor: Actor, params: nn.Parameter) -> None:
        self._loss, self._params = loss, params
        self._widths = (actor.observation_dim, len(actor.action_scale), 1, 1, 1)

    def __call__(self, rows: Tensor) -> Told:
        """See `Gradients`."""
        zero_gradient(self._params)
        found = self._loss(self._samples(rows))
        sum(losses(found).values()).backward()
        names = (*Told._fields[:3], "kl_approx", "clip_fraction")
        return Told(*(found.get(name, torch.zeros(())).item() for name in names))

    def _samples(self, rows: Tensor) -> TensorDict:
        state, action, log_prob, advantage, target = rows.split(self._widths, 1)
        return TensorDict(
            {
                "observation": state,
                "action": action,
                "action_log_prob": log_prob.squeeze(-1),
                "advantage": advantage,
                "value_target": target,
            },
            rows.shape[:1],
        )


class NativeGradients:
    """The same in native code, on several threads, whatever their number."""

    def __init__(
        self,
        loss: PPOLoss,
        actor: Actor,
        critic: nn.Module,
        params: nn.Parameter,
        threads: int,
    ) -> None:
        self._actor, self._states = actor, actor.observation_dim
        self._params, self._threads = params, threads
        self._entropy_coefficient = float(loss.entropy_coeff)
        self._nets = Nets(
            params=params.data.numpy(),
            actor_layout=layout_of(widths_of(actor.body), TANH, PART),
            critic_layout=layout_of(widths_of(critic), TANH, PART),
            log_std_at=sum(p.numel() for p in actor.body.parameters()),
            action_scale=actor.action_scale.numpy(),
            clip=float(getattr(loss, "clip_epsilon", math.inf)),
            critic_coefficient=float(loss.critic_coeff),
        )
        self._reserve(0)

    def __call__(self, rows: Tensor) -> Told:
        """See `Gradients`."""
        if len(self._found) != parts_of(len(rows)):
            self._reserve(len(rows))
        self._parts.run(ppo_gradients, self._nets, self._normalised(rows))
        torch.sum(self._grads, 0, out=self._params.grad).div_(len(rows))
        assert self._actor.log_std.grad is not None
        self._actor.log_std.grad.sub_(self._entropy_coefficient)
        objective, critic, kl, clipped = map(float, self._found.sum(0) / len(rows))
        return Told(objective, critic, self._entropy(), kl, clipped)

    def _reserve(self, batch: int) -> None:
        work = work_for(self._nets, parts_of(batch), PART)
        self._grads, self._found = torch.from_numpy(work.grads), work.found
        scratch = [Work(*arrays) for arrays in zip(*work, strict=True)]
        self._parts = Parts(scratch, self._threads)

    def _normalised(self, rows: Tensor) -> Tensor:
        advantage = rows[:, -2]
        rows = rows.clone()
        rows[:, : self._states] = self._actor.norm(rows[:, : self._states])
        if len(rows) > 1:
            deviation = advantage.std().clamp_min(MIN_DEVIATION)
            rows[:, -2] = (advantage - advantage.mean()) / deviation
        return rows

    def _entropy(self) -> float:
        """Of the Gaussian, in any state: sum of log(sqrt(2 pi e) deviation)."""
        deviation = self._actor.action_scale * self._actor.log_std.detach().exp()
        return float((ENTROPY + deviation.log()).sum())
