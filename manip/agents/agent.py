"""What the training loop asks of an algorithm."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import nn

from manip.agents.networks import Actor, BinnedActor


@dataclass(frozen=True)
class Spaces:
    """Sizes that an agent is built for."""

    observation_dim: int
    action_dim: int


class Agent(ABC):
    """An algorithm: a rollout policy, and an update from what it collected.

    Attributes:
        actor: the network that is deployed.
        rollout_length: control steps T of every world between two updates.
        off_policy: learns from what older policies collected, too.
        imitates: asks the worlds what the task's script would do (`script` [N, A]).
        has_native_gradients: takes the keyword `gradients`, "native" or "torchrl";
            other algorithms always learn through TorchRL's losses and autograd.
        workers: rollouts that are under way side by side, in worlds of their own.
    """

    actor: Actor | BinnedActor
    rollout_length: int
    off_policy: bool = False
    imitates: bool = False
    has_native_gradients: bool = False
    workers: int = 1

    @abstractmethod
    def policy(self) -> TensorDictModuleBase:
        """Explores as the agent does now: writes `action` [N, A] to its input.

        A copy, with random numbers of its own: it may act while the agent learns.
        """

    def process_rollout(
        self, policy: TensorDictModuleBase, batch: TensorDictBase
    ) -> TensorDictBase:
        """What `update` learns from: the policy's rollout [N, T], or findings in it.

        Called on the thread that collected the rollout, while others may learn.
        """
        return batch

    @abstractmethod
    def update(self, batch: TensorDictBase) -> dict[str, float]:
        """Learn from a rollout; scalars to log, empty before learning starts."""

    @abstractmethod
    def modules(self) -> dict[str, nn.Module]:
        """Everything with parameters or buffers, by name, for checkpoints."""

    @abstractmethod
    def optimisers(self) -> dict[str, torch.optim.Optimizer]:
        """Everything with optimiser state, by name, for checkpoints."""

    def extra_state(self, buffer: bool = True) -> dict[str, Any]:
        """Tensors and numbers besides modules and optimisers.

        What is stored of old rollouts is called `buffer`, and None unless asked for.
        """
        return {}

    def load_extra_state(self, state: dict[str, Any]) -> None:
        """Put back what `extra_state` gave."""
