"""Behaviour cloning of a task's expert (Pomerleau 1989), with TorchRL's BCLoss.

    actor: min |pi(s) - a*(s)|,  s ~ noisy episodes of the expert, and of the clone

a* is the expert's action in state s. Clones of a perfect expert never see how to return
from their own mistakes, so the states are disturbed in two ways. In some environments
the expert acts, with noise as in DART (Laskey et al. 2017, arXiv 1703.09327) that grows
from none in the first environment to `noise` in the last. In the others, from the
second rollout on, the clone acts and the expert only labels the states: DAgger (Ross et
al. 2011, arXiv 1011.0686).
"""

import warnings
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Annotated, Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import Tensor, nn
from torch.optim import Adam
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.objectives import BCLoss

from manip.agents.agent import Agent, AgentConfig, Spaces
from manip.agents.networks import Actor, seeded_generator
from manip.agents.off_policy import descend
from manip.io.option_ranges import COUNT, NUMBER, SHARE

# BCLoss has no target networks, and warns of it.
warnings.filterwarnings("ignore", "The name target_actor_network_params")

KEYS = ("observation", "expert_action")
"""Keys of a step that are stored."""


@dataclass(frozen=True)
class BCConfig(AgentConfig):
    """Options of behaviour cloning; `steps` of the run are those of the expert."""

    noise: Annotated[float, NUMBER] = 0.3
    """Largest standard deviation of the expert's action noise: it rises linearly from 0
    in the first environment to this value."""
    noise_steps: Annotated[int, COUNT] = 10
    """Mean number of control steps for which a noise sample is used."""
    clones: Annotated[float, SHARE] = 0.5
    """Fraction of the environments in which the clone acts (DAgger)."""
    rollout_length: Annotated[int, COUNT] = 32
    """Control steps of each environment between two rounds of updates."""
    updates_per_step: Annotated[float, NUMBER] = 0.5
    """Updates per control step of one environment."""
    batch_size: Annotated[int, COUNT] = 256
    """Labelled steps per update (minibatch size)."""
    learning_rate: Annotated[float, NUMBER] = 5e-4
    """Adam's step size."""
    actor_hidden: Annotated[tuple[int, ...], COUNT] = (256, 256)
    """Widths of the actor's hidden layers."""
    buffer_size: Annotated[int, COUNT] = 400_000
    """Capacity of the buffer of labelled steps [control steps]."""


class Demonstration(TensorDictModuleBase):
    """Act as the expert, with noise that lasts several steps; or as its clone.

    Args:
        clones: fraction of the environments, the last ones, in which the clone acts.
    """

    in_keys = ["observation", "expert_action"]
    out_keys = ["action"]

    def __init__(
        self, actor: Actor, noise: float, noise_steps: int, clones: float
    ) -> None:
        super().__init__()
        self._actor, self._clones = deepcopy(actor), clones
        self._noise, self._renewal = noise, 1 / noise_steps
        self._generator = seeded_generator()
        self._offset: Tensor | None = None

    @torch.no_grad()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write `action` [N, A]."""
        observation, expert = tensordict["observation"], tensordict["expert_action"]
        first = len(expert) - round(self._clones * len(expert))
        clone = self._actor.decide(observation[first:])
        action = torch.cat([self._add_noise(expert[:first]), clone])
        return tensordict.set("action", action.clamp(-1, 1))

    def _add_noise(self, action: Tensor) -> Tensor:
        level = torch.linspace(0, self._noise, len(action))[:, None]
        return action + level * self._offsets(action.shape)

    def _offsets(self, shape: torch.Size) -> Tensor:
        """Draw standard normal noise [N, A]; rows are redrawn at random times."""
        offset = torch.randn(shape, generator=self._generator)
        if self._offset is not None:
            chance = torch.rand((len(offset), 1), generator=self._generator)
            offset = torch.where(chance < self._renewal, offset, self._offset)
        self._offset = offset
        return offset


class BC(Agent):
    """Behaviour cloning; see the module's docstring."""

    name = "bc"
    Config = BCConfig
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
        """Return the noisy expert, and from the second rollout on also the clone."""
        config = self.config
        clones = config.clones if len(self._buffer) else 0.0
        return Demonstration(self.actor, config.noise, config.noise_steps, clones)

    def update(self, batch: TensorDictBase) -> dict[str, float]:
        """Store the rollout [N, T]; then do as many updates as its steps call for."""
        labelled = batch.select(*KEYS).reshape(-1)
        self._buffer.extend(labelled)
        self._owed += len(labelled) * self.config.updates_per_step
        count, self._owed = int(self._owed), self._owed % 1
        losses = [self._learn(part) for part in self._sample(count)]
        return {"loss_actor": sum(losses) / count} if losses else {}

    def modules(self) -> dict[str, nn.Module]:
        """Return the actor."""
        return {"actor": self.actor}

    def optimisers(self) -> dict[str, torch.optim.Optimizer]:
        """Return one for the actor."""
        return {"actor": self._optim}

    def extra_state(self, buffer: bool = True) -> dict[str, Any]:
        """Return the stored steps, oldest place first, and the updates owed."""
        stored = buffer and len(self._buffer) > 0
        return {
            "buffer": self._buffer[:].select(*KEYS).to_dict() if stored else None,
            "cursor": self._buffer.writer._cursor if stored else 0,
            "owed": self._owed,
        }

    def load_extra_state(self, state: dict[str, Any]) -> None:
        """Restore what `extra_state` returned.

        Raises:
            ValueError: it is of another buffer, or damaged.
        """
        if state["buffer"] is not None:
            self._buffer.extend(self._checked(state["buffer"]))
        if not 0 <= state["cursor"] <= len(self._buffer) or not 0 <= state["owed"] < 1:
            raise ValueError("the checkpoint's counters are out of range")
        self._buffer.writer._cursor = state["cursor"]
        self._owed = state["owed"]

    def _checked(self, stored: dict[str, Tensor]) -> TensorDict:
        widths = self.actor.observation_dim, len(self.actor.action_scale)
        size = len(stored["expert_action"])
        shapes = {key: (size, width) for key, width in zip(KEYS, widths, strict=True)}
        if {key: tuple(value.shape) for key, value in stored.items()} != shapes:
            raise ValueError("the replay buffer holds steps of other shapes")
        if size > self.config.buffer_size:
            raise ValueError(f"the replay buffer holds {size} steps, more than fit")
        return TensorDict(dict(stored), [size])

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
