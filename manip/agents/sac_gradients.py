"""Gradients of SAC's losses: as TorchRL defines them, and the same in native code."""

import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple, Protocol

import numpy as np
import scipy.linalg.cython_blas  # noqa: F401 - loaded now, to be limited below
import torch
from tensordict import TensorDict, TensorDictBase
from threadpoolctl import ThreadpoolController
from torch import Tensor, nn
from torchrl.objectives import SACLoss

from manip.agents.flat import flatten
from manip.agents.kernels import layout_of
from manip.agents.networks import Actor, widths_of
from manip.agents.sac_kernels import (
    Nets,
    Work,
    actor_gradients,
    critic_gradients,
    work_for,
)

# The targets are moved by one call in SAC._learn, not by torchrl's updater; gradients
# are views of flat ones.
warnings.filterwarnings("ignore", "No target network updater")
warnings.filterwarnings("ignore", "grad and param do not obey")

PART = 128
"""Rows of a batch that a thread takes at a time: fixed, so that sums come out alike."""

TOLERANCE = 1e-3
"""Native gradients may differ from autograd's by this part of their length."""


Job = tuple[Nets, np.ndarray, np.ndarray, Work]
Kernel = Callable[[Nets, np.ndarray, np.ndarray, Work], None]
"""Gradients of a part of a batch: rows, noise, scratch; see `sac_kernels`."""


class FlatParams(NamedTuple):
    """SACLoss's parameters, flat: actor and temperature [P + 1], critics [2, Q]."""

    actor: nn.Parameter
    critics: nn.Parameter
    targets: nn.Parameter

    def gradient(self) -> Tensor:
        """A copy of both gradients in one row."""
        found = (self.actor.grad, self.critics.grad)
        return torch.cat([grad.flatten() for grad in found if grad is not None])


class Gradients(Protocol):
    """Writes the gradients of a batch of rows (see `sac_kernels`) to the parameters."""

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


def rows_of(transitions: TensorDictBase) -> Tensor:
    """Transitions [B] as rows [B, 2 O + A + 3]; see `sac_kernels`."""
    after = transitions["next"]
    parts = [
        transitions["observation"],
        transitions["action"],
        after["observation"],
        after["reward"],
        transitions["steps_to_next_obs"],
        after["terminated"],
    ]
    return torch.cat([part.float() for part in parts], -1)


def sac_gradients(
    loss: SACLoss,
    params: FlatParams,
    actor: Actor,
    gamma: float,
    batch: int,
    threads: int,
) -> Gradients:
    """Native gradients where they agree with autograd's, autograd's elsewhere."""
    defined = AutogradGradients(loss, params, actor.observation_dim)
    native = NativeGradients(_nets(loss, params, actor, gamma), params, batch, threads)
    if _agree(native, defined, params, actor, batch):
        return native
    warnings.warn(
        "native SAC gradients differ from TorchRL's on this machine: using the slower "
        "ones of autograd",
        stacklevel=2,
    )
    return defined


def _nets(loss: SACLoss, params: FlatParams, actor: Actor, gamma: float) -> Nets:
    critic = loss.qvalue_network.module
    return Nets(
        actor=params.actor.data.numpy(),
        critics=params.critics.data.numpy(),
        targets=params.targets.data.numpy(),
        actor_layout=layout_of(widths_of(actor.body), False, PART),
        critic_layout=layout_of(widths_of(critic), True, PART),
        action_scale=actor.action_scale.numpy(),
        gamma=gamma,
        target_entropy=float(loss.target_entropy),
    )


def _agree(
    native: Gradients, defined: Gradients, params: FlatParams, actor: Actor, batch: int
) -> bool:
    """Whether both give the same gradients on random transitions."""
    states, actions = actor.observation_dim, len(actor.action_scale)
    found = []
    with torch.random.fork_rng():
        rows = torch.randn(batch, 2 * states + actions + 3)
        rows[:, states : states + actions].tanh_()
        rows[:, -2:] = torch.tensor([1.0, 0.0])
        for gradients in (native, defined):
            torch.manual_seed(0)
            gradients.critic(rows)
            gradients.actor(rows)
            found.append(params.gradient())
    return bool((found[0] - found[1]).norm() <= TOLERANCE * found[1].norm())


class AutogradGradients:
    """TorchRL's SACLoss and PyTorch's autograd: the definition."""

    def __init__(self, loss: SACLoss, params: FlatParams, states: int) -> None:
        self._loss, self._params = loss, params
        self._states = states

    def critic(self, rows: Tensor) -> float:
        """See `Gradients`."""
        _zero_gradient(self._params.critics)
        loss, _ = self._loss.qvalue_v2_loss(self._batch(rows))
        loss.backward()
        return loss.item()

    def actor(self, rows: Tensor) -> tuple[float, float]:
        """See `Gradients`."""
        _zero_gradient(self._params.actor)
        loss, found = self._loss.actor_loss(self._batch(rows))
        log_prob = found["log_prob"]
        (loss + self._loss.alpha_loss(log_prob).mean()).backward()
        return loss.item(), log_prob.mean().item()

    def _batch(self, rows: Tensor) -> TensorDict:
        states = self._states
        actions = rows.shape[1] - 2 * states - 3
        widths = (states, actions, states, 1, 1, 1)
        state, action, following, reward, steps, terminated = rows.split(widths, 1)
        ended = terminated > 0
        after = {"observation": following, "reward": reward}
        after |= {"terminated": ended, "done": ended}
        return TensorDict(
            {
                "observation": state,
                "action": action,
                "steps_to_next_obs": steps,
                "next": TensorDict(after, rows.shape[:1]),
            },
            rows.shape[:1],
        )


def _zero_gradient(param: nn.Parameter) -> None:
    """In place: the loss's own gradients are views of it."""
    assert param.grad is not None
    param.grad.zero_()


class NativeGradients:
    """The same in native code, on several threads.

    A batch is cut into parts of a fixed size whose gradients are summed in order: the
    result does not depend on the number of threads.
    """

    def __init__(self, nets: Nets, params: FlatParams, batch: int, threads: int):
        ThreadpoolController().select(internal_api="openblas").limit(limits=1)
        self._nets, self._params = nets, params
        work = work_for(nets, -(-batch // PART), PART)
        self._parts = [Work(*arrays) for arrays in zip(*work, strict=True)]
        self._d_actor = torch.from_numpy(work.d_actor)
        self._d_critics = torch.from_numpy(work.d_critics)
        self._found = work.found
        self._threads = min(threads, len(self._parts))
        self._pool = ThreadPoolExecutor(max(1, self._threads - 1), "manip-learn")

    def critic(self, rows: Tensor) -> float:
        """See `Gradients`."""
        self._run(critic_gradients, rows)
        grad = torch.sum(self._d_critics, 0, out=self._params.critics.grad)
        grad.div_(len(rows))
        return float(self._found[:, 0].sum()) / len(rows)

    def actor(self, rows: Tensor) -> tuple[float, float]:
        """See `Gradients`."""
        self._run(actor_gradients, rows)
        grad = torch.sum(self._d_actor, 0, out=self._params.actor.grad)
        grad.div_(len(rows))
        loss, log_prob = self._found.sum(0) / len(rows)
        return float(loss), float(log_prob)

    def _run(self, gradients: Kernel, rows: Tensor) -> None:
        noise = torch.randn(len(rows), len(self._nets.action_scale))
        pieces = zip(rows.split(PART), noise.split(PART), self._parts, strict=True)
        jobs = [(self._nets, r.numpy(), n.numpy(), work) for r, n, work in pieces]
        others = [
            self._pool.submit(_run_all, gradients, jobs[thread :: self._threads])
            for thread in range(1, self._threads)
        ]
        _run_all(gradients, jobs[:: self._threads])
        for other in others:
            other.result()


def _run_all(gradients: Kernel, jobs: Sequence[Job]) -> None:
    for job in jobs:
        gradients(*job)
