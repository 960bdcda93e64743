"""Gradients of PPO's loss: by TorchRL and autograd, and the same in native code."""

import math
from functools import partial
from typing import NamedTuple, Protocol

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor, nn
from torchrl.modules import IndependentNormal
from torchrl.objectives import PPOLoss

from manip.agents.bounded_gaussian import BoundedGaussian
from manip.agents.flat_parameters import zero_gradient
from manip.agents.native.gradient_check import (
    GradientCheck,
    GradientSource,
    perturbed,
)
from manip.agents.native.gradient_probes import entropy_probe, ppo_probe
from manip.agents.native.mlp_kernels import TANH, layout_of
from manip.agents.native.ppo_kernels import Nets, Work, ppo_gradients, work_for
from manip.agents.native.row_blocks import BLOCK_ROWS, RowBlocks, count_blocks
from manip.agents.networks import Actor, widths_of
from manip.agents.on_policy import losses

MIN_DEVIATION = 1e-6
"""Least standard deviation that advantages are divided by (ClipPPOLoss)."""

UNIT_ENTROPY = 0.5 * math.log(2 * math.pi * math.e)
"""Entropy [nat] of a normal distribution of deviation 1."""

PROBE_CLIP = 0.2
"""eps of probe rows where the objective is not clipped."""


class MinibatchStats(NamedTuple):
    """Numbers reported of a minibatch, before its step; kl is `kl_divergence`."""

    loss_objective: float
    loss_critic: float
    entropy: float
    kl: float
    clip_fraction: float


class Gradients(Protocol):
    """Writes the loss's gradients for a minibatch of rows (see `rows_of`)."""

    def __call__(self, rows: Tensor) -> MinibatchStats:
        """Write the gradients to the parameters."""


def rows_of(samples: TensorDictBase) -> Tensor:
    """Samples [B] as rows [B, O + A + 3]: s, a, log pi_old, advantage, value target."""
    columns = [
        samples["observation"],
        samples["action"],
        samples["action_log_prob"].unsqueeze(-1),
        samples["advantage"],
        samples["value_target"],
    ]
    return torch.cat(columns, -1)


@torch.no_grad()
def kl_divergence(actor: Actor | BoundedGaussian, rows: Tensor) -> float:
    """Estimate KL(pi_old || pi) [nat] from rows: mean of (rho - 1) - log rho.

    Schulman's k3 (joschu.net/blog/kl-approx.html): unbiased, and never negative.
    """
    state, action, log_prob_old, _ = rows.split(_widths(actor), 1)
    log_prob = IndependentNormal(*actor(state)).log_prob(action)
    log_ratio = log_prob - log_prob_old.squeeze(-1)
    return (log_ratio.exp() - 1 - log_ratio).mean().item()


def _widths(actor: Actor | BoundedGaussian) -> tuple[int, int, int, int]:
    """Columns of state, action, log pi_old, and of advantage with value target."""
    return actor.observation_dim, len(actor.action_scale), 1, 2


def gradients_of(
    loss: PPOLoss,
    actor: Actor | BoundedGaussian,
    critic: nn.Module,
    params: nn.Parameter,
    threads: int,
    source: GradientSource,
) -> Gradients:
    """Return checked native gradients, or TorchRL's if `source` is "torchrl".

    There are none in native code for a bounded mean, or on other devices than the CPU.
    """
    reference = AutogradGradients(loss, actor, params)
    elsewhere = params.device.type != "cpu"
    if source == "torchrl" or elsewhere or isinstance(actor, BoundedGaussian):
        return reference
    native = NativeGradients(loss, actor, critic, params, threads)
    return CheckedGradients(native, reference, actor, critic, native.clip)


class AutogradGradients:
    """TorchRL's (Clip)PPOLoss and PyTorch's autograd."""

    def __init__(
        self, loss: PPOLoss, actor: Actor | BoundedGaussian, params: nn.Parameter
    ) -> None:
        self._loss, self._actor, self._params = loss, actor, params

    def __call__(self, rows: Tensor) -> MinibatchStats:
        """See `Gradients`."""
        zero_gradient(self._params)
        outputs = self._loss(self._samples(rows))
        sum(losses(outputs).values()).backward()
        zero = torch.zeros(())
        objective, critic, entropy, clip_fraction = (
            outputs.get(name, zero).item()
            for name in ("loss_objective", "loss_critic", "entropy", "clip_fraction")
        )
        kl = kl_divergence(self._actor, rows)
        return MinibatchStats(objective, critic, entropy, kl, clip_fraction)

    def _samples(self, rows: Tensor) -> TensorDict:
        state, action, log_prob, rest = rows.split(_widths(self._actor), 1)
        advantage, target = rest.split(1, 1)
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
    """The same in native code; the number of threads does not change a bit."""

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
        self.clip = float(getattr(loss, "clip_epsilon", math.inf))
        self._nets = Nets(
            params=params.data.numpy(),
            actor_layout=layout_of(widths_of(actor.body), TANH, BLOCK_ROWS),
            critic_layout=layout_of(widths_of(critic), TANH, BLOCK_ROWS),
            log_std_at=sum(p.numel() for p in actor.body.parameters()),
            action_scale=actor.action_scale.numpy(),
            clip=self.clip,
            critic_coefficient=float(loss.critic_coeff or 0.0),  # None for 0
        )
        self._reserve(0)

    def __call__(self, rows: Tensor) -> MinibatchStats:
        """See `Gradients`."""
        if len(self._sums) != count_blocks(len(rows)):
            self._reserve(len(rows))
        self._blocks.run(ppo_gradients, self._nets, self._normalised(rows))
        torch.sum(self._grads, 0, out=self._params.grad).div_(len(rows))
        # The entropy grows by 1 nat with each log deviation, in every state.
        assert self._actor.log_std.grad is not None
        self._actor.log_std.grad.sub_(self._entropy_coefficient)
        objective, critic, kl, clipped = map(float, self._sums.sum(0) / len(rows))
        return MinibatchStats(objective, critic, self._entropy(), kl, clipped)

    def _reserve(self, batch: int) -> None:
        work = work_for(self._nets, count_blocks(batch), BLOCK_ROWS)
        self._grads, self._sums = torch.from_numpy(work.grads), work.sums
        workspaces = [Work(*arrays) for arrays in zip(*work, strict=True)]
        self._blocks = RowBlocks(workspaces, self._threads)

    def _normalised(self, rows: Tensor) -> Tensor:
        """Rows with normalised states, and advantages of mean 0 and deviation 1."""
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
        return float((UNIT_ENTROPY + deviation.log()).sum())


class CheckedGradients(GradientCheck[Gradients]):
    """Native gradients while they agree with TorchRL's."""

    def __init__(
        self,
        native: Gradients,
        reference: Gradients,
        actor: Actor,
        critic: nn.Module,
        clip: float,
    ) -> None:
        super().__init__(native, reference)
        params = [*actor.named_parameters(prefix="actor")]
        params += critic.named_parameters(prefix="critic")
        self._params = dict(params)
        clip = clip if math.isfinite(clip) else PROBE_CLIP
        spread = partial(ppo_probe, actor, clip, 2 * BLOCK_ROWS + 1)
        tensors = [param.data for param in self._params.values()]
        with perturbed([*tensors, *actor.norm.buffers()]):
            probes = (spread, partial(entropy_probe, actor, clip))
            agree = all(self._agree_on_probe(probe) for probe in probes)
        if not agree:
            self._fall_back()

    def __call__(self, rows: Tensor) -> MinibatchStats:
        """See `Gradients`."""
        return self._select(rows)(rows)

    def _measure(self, gradients: Gradients, rows: Tensor) -> dict[str, Tensor]:
        numbers = gradients(rows)._asdict()
        reported = {name: torch.tensor(number) for name, number in numbers.items()}
        grads = {name: param.grad for name, param in self._params.items()}
        return reported | {k: v.clone() for k, v in grads.items() if v is not None}
