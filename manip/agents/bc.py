"""Behaviour cloning of a task's expert (Pomerleau 1989), with TorchRL's BCLoss.

    actor: min |pi(s) - a*(s)|,  s ~ noisy episodes of the expert, and of the clone

a* is the expert's action in state s. Clones of a perfect expert never see how to return
from their own mistakes, so the states are disturbed in two ways. In some environments
the expert acts, with noise as in DART (Laskey et al. 2017, arXiv 1703.09327) that grows
from none in the first environment to `noise` in the last. In the others, from the
second rollout on, the clone acts and the expert only labels the states: DAgger (Ross et
al. 2011, arXiv 1011.0686).

The expert always acts on the whole observation. The actor may see camera images and
proprioception instead (`Spaces.actor`): it is then the student of a privileged teacher
(Chen et al. 2020, arXiv 1912.12294), and learns to predict, too, what only the teacher
sees (see `manip.agents.cloning_losses`). It is not deployed with that prediction.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torch.optim import Adam
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer

from manip.agents.agent import Agent, Spaces
from manip.agents.cloning_losses import cloning_losses
from manip.agents.demonstration import Demonstration
from manip.agents.image_actor import ImageActor
from manip.agents.make_actor import ImageConfig, make_actor
from manip.agents.networks import Actor
from manip.agents.off_policy import descend
from manip.io.option_ranges import COUNT, NUMBER, SHARE


@dataclass(frozen=True)
class BCConfig(ImageConfig):
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
    auxiliary: Annotated[float, NUMBER] = 1.0
    """Weight of the loss by which an actor with cameras also learns to predict the
    parts of the observation that it does not see, such as the objects' poses."""


class BC(Agent):
    """Behaviour cloning; see the module's docstring."""

    name = "bc"
    Config = BCConfig
    off_policy = True
    imitates = True
    takes_datasets = True
    sees_images = True
    actor: Actor | ImageActor

    def __init__(self, config: BCConfig, spaces: Spaces, threads: int = 1) -> None:
        self.config, self._spaces = config, spaces
        self.rollout_length = config.rollout_length
        self.actor = make_actor(
            spaces, config, config.actor_hidden, squash=True, normalise=False
        )
        self._losses = cloning_losses(
            self.actor, spaces, config.auxiliary, config.image_shift
        )
        parameters = [p for m in self.modules().values() for p in m.parameters()]
        self._optim = Adam(parameters, config.learning_rate, fused=True)
        self._buffer = TensorDictReplayBuffer(
            storage=LazyTensorStorage(config.buffer_size)
        )
        self._owed = 0.0

    @property
    def _keys(self) -> tuple[str, ...]:
        """Keys of a step that are stored."""
        return (*self._spaces.inputs.keys, "expert_action")

    def policy(self) -> TensorDictModuleBase:
        """Return the noisy expert, and from the second rollout on also the clone."""
        config = self.config
        clones = config.clones if len(self._buffer) else 0.0
        noise = config.noise, config.noise_steps
        return Demonstration(self.actor, self._spaces.inputs, *noise, clones)

    def update(self, batch: TensorDictBase) -> dict[str, float]:
        """Store the rollout [N, T]; then do as many updates as its steps call for."""
        labelled = batch.select(*self._keys).reshape(-1)
        self._buffer.extend(labelled)
        self._owed += len(labelled) * self.config.updates_per_step
        count, self._owed = int(self._owed), self._owed % 1
        losses = [self._learn(part) for part in self._sample(count)]
        names = losses[0] if losses else ()
        return {f"loss_{n}": sum(loss[n] for loss in losses) / count for n in names}

    def modules(self) -> dict[str, nn.Module]:
        """Return the actor, and what its loss needs besides."""
        return {"actor": self.actor, **self._losses.extra}

    def optimisers(self) -> dict[str, torch.optim.Optimizer]:
        """Return one for the actor."""
        return {"actor": self._optim}

    def extra_state(self, buffer: bool = True) -> dict[str, Any]:
        """Return the stored steps, oldest place first, and the updates owed."""
        stored = buffer and len(self._buffer) > 0
        return {
            "buffer": self._buffer[:].select(*self._keys).to_dict() if stored else None,
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
        spaces, size = self._spaces, len(stored["expert_action"])
        shapes = {
            "observation": (size, spaces.observation_dim),
            "expert_action": (size, spaces.action_dim),
            **{c.name: (size, *c.shape) for c in spaces.inputs.cameras},
        }
        if {key: tuple(value.shape) for key, value in stored.items()} != shapes:
            raise ValueError("the replay buffer holds steps of other shapes")
        if size > self.config.buffer_size:
            raise ValueError(f"the replay buffer holds {size} steps, more than fit")
        return TensorDict(dict(stored), [size])

    def _sample(self, batches: int) -> Sequence[TensorDictBase]:
        size = self.config.batch_size
        return self._buffer.sample(batches * size).split(size) if batches else ()

    def _learn(self, batch: TensorDictBase) -> dict[str, float]:
        losses = self._losses(batch)
        descend(self._optim, sum(losses.values(), torch.zeros(())))
        return {name: loss.item() for name, loss in losses.items()}
