"""Behaviour cloning of a task's script (Pomerleau 1989), on TorchRL's BCLoss.

    actor: min |pi(s) - a*(s)|,  s ~ episodes of the script, disturbed, and of the clone

a* is what the script would do in s. Both kinds of states are such that it shows the way
back from them; without, the clone would know none once it has strayed. In some worlds
the script acts, with noise as in DART (Laskey et al. 2017, arXiv 1703.09327) that grows
from world to world, from none in the first one on. In the others, once something is
learned, the clone acts and the script only tells what it would do: DAgger (Ross et al.
2011, arXiv 1011.0686).
"""

import warnings
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import Tensor, nn
from torch.optim import Adam
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.objectives import BCLoss

from manip.agents.agent import Agent, Spaces
from manip.agents.networks import Actor, seeded
from manip.agents.off_policy import descend

# It has no targets, and does not say so.
warnings.filterwarnings("ignore", "The name target_actor_network_params")

KEYS = ("observation", "expert_action")
"""What is kept of a step."""


@dataclass(frozen=True)
class BCConfig:
    """Options of behaviour cloning; `steps` of the run are those of the script."""

    noise: float = 0.3
    """Standard deviation of the actions' noise in the last world."""
    noise_steps: int = 10
    """Control steps for which noise lasts, on average, before it is drawn anew."""
    clones: float = 0.5
    """Share of the worlds in which the clone acts, from the second rollout on."""
    rollout_length: int = 32
    """Control steps of every world between two rounds of updates."""
    updates_per_step: float = 0.5
    """Updates for each control step of each world."""
    batch_size: int = 256
    """Steps an update."""
    learning_rate: float = 5e-4
    """Adam's step size."""
    actor_hidden: tuple[int, ...] = (256, 256)
    """Widths of the actor's hidden layers."""
    buffer_size: int = 400_000
    """Steps that are kept."""


class Demonstration(TensorDictModuleBase):
    """What the script says, with noise that lasts for a while; or what its clone does.

    Args:
        clones: share of the worlds, the last ones, in which the clone acts.
    """

    in_keys = ["observation", "expert_action"]
    out_keys = ["action"]

    def __init__(
        self, actor: Actor, noise: float, noise_steps: int, clones: float
    ) -> None:
        super().__init__()
        self._actor, self._clones = deepcopy(actor), clones
        self._noise, self._renewed = noise, 1 / noise_steps
        self._generator = seeded()
        self._offset: Tensor | None = None

    @torch.no_grad()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write `action` [N, A]."""
        seen, wanted = tensordict["observation"], tensordict["expert_action"]
        first = len(wanted) - round(self._clones * len(wanted))
        own = self._actor.decide(seen[first:])
        action = torch.cat([self._disturbed(wanted[:first]), own])
        return tensordict.set("action", action.clamp(-1, 1))

    def _disturbed(self, wanted: Tensor) -> Tensor:
        level = torch.linspace(0, self._noise, len(wanted))[:, None]
        return wanted + level * self._offsets(wanted.shape)

    def _offsets(self, shape: torch.Size) -> Tensor:
        drawn = torch.randn(shape, generator=self._generator)
        if self._offset is not None:
            chance = torch.rand((len(drawn), 1), generator=self._generator)
            drawn = torch.where(chance < self._renewed, drawn, self._offset)
        self._offset = drawn
        return drawn


class BC(Agent):
    """Behaviour cloning; see the module's docstring."""

    off_policy = True
    imitates = True
    actor: Actor

    def __init__(self, config: BCConfig, spaces: Spaces, threads: int = 1) -> None:
        self.config = config
        self.rollout_length = config.rollout_length
        self.actor = Actor(
            spaces.observation_dim,
            spaces.action_dim,
            config.actor_hidden,
            squash=True,
            normalise=False,
        )
        self._loss = _loss(self.actor)
        self._optim = Adam(self.actor.parameters(), config.learning_rate, fused=True)
        self._buffer = TensorDictReplayBuffer(
            storage=LazyTensorStorage(config.buffer_size)
        )
        self._owed = 0.0

    def policy(self) -> TensorDictModuleBase:
        """The script, disturbed, and once something is learned the clone."""
        config = self.config
        clones = config.clones if len(self._buffer) else 0.0
        return Demonstration(self.actor, config.noise, config.noise_steps, clones)

    def update(self, batch: TensorDictBase) -> dict[str, float]:
        """Store the rollout [N, T]; then as many updates as its steps call for."""
        shown = batch.select(*KEYS).reshape(-1)
        self._buffer.extend(shown)
        self._owed += len(shown) * self.config.updates_per_step
        count, self._owed = int(self._owed), self._owed % 1
        losses = [self._learn(part) for part in self._sample(count)]
        return {"loss_actor": sum(losses) / count} if losses else {}

    def modules(self) -> dict[str, nn.Module]:
        """The actor."""
        return {"actor": self.actor}

    def optimisers(self) -> dict[str, torch.optim.Optimizer]:
        """One for the actor."""
        return {"actor": self._optim}

    def extra_state(self, buffer: bool = True) -> dict[str, Any]:
        """What the script has shown, oldest place first, and the updates owed."""
        kept = buffer and len(self._buffer) > 0
        return {
            "buffer": self._buffer[:].select(*KEYS).to_dict() if kept else None,
            "cursor": self._buffer.writer._cursor if kept else 0,
            "owed": self._owed,
        }

    def load_extra_state(self, state: dict[str, Any]) -> None:
        """Refill the buffer in the same order."""
        if state["buffer"] is not None:
            size = state["buffer"]["expert_action"].shape[:1]
            self._buffer.extend(TensorDict(state["buffer"], size))
        self._buffer.writer._cursor = state["cursor"]
        self._owed = state["owed"]

    def _sample(self, batches: int) -> Sequence[TensorDictBase]:
        size = self.config.batch_size
        return self._buffer.sample(batches * size).split(size) if batches else ()

    def _learn(self, batch: TensorDictBase) -> float:
        loss = self._loss(batch)["loss_bc"]
        descend(self._optim, loss)
        return loss.item()


class _Decision(nn.Module):
    """An actor's deterministic action."""

    def __init__(self, actor: Actor) -> None:
        super().__init__()
        self.actor = actor

    def forward(self, observation: Tensor) -> Tensor:
        return self.actor.decide(observation)


def _loss(actor: Actor) -> BCLoss:
    module = TensorDictModule(_Decision(actor), ["observation"], ["expert_action"])
    loss = BCLoss(module, loss_function="l1")
    loss.set_keys(action="expert_action")
    return loss
