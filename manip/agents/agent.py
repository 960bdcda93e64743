"""The contract between an algorithm and the training loop."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn

from manip.agents.actor_inputs import ActorInputs
from manip.agents.compared_clips import ComparedClips
from manip.agents.image_actor import ImageActor
from manip.agents.networks import Actor, BinnedActor
from manip.rewards.reward_function import RewardFunction


@dataclass(frozen=True)
class AgentConfig:
    """Base class of every algorithm's options.

    Each field becomes a flag `--agent.<name>`, with the string below it as its help.
    A range beside a number is checked wherever the option is set (see
    manip.io.option_ranges): `gamma: Annotated[float, SHARE] = 0.95`.
    """

    workers = 1
    """Groups of environments whose rollouts are collected side by side."""

    asynchronous = False
    """Learn from the rollouts of the groups as they end, not in turns."""


@dataclass(frozen=True)
class Spaces:
    """Sizes that an agent's networks are built for.

    Attributes:
        observation_dim: D, length of the joined observation, which a critic may see.
        action_dim: A.
        actor: what the actor sees; the joined observation if None.
    """

    observation_dim: int
    action_dim: int
    actor: ActorInputs | None = None

    @property
    def inputs(self) -> ActorInputs:
        """What the actor sees."""
        return self.actor or ActorInputs()

    @property
    def vector_dim(self) -> int:
        """V, number of entries of the joined observation that the actor sees."""
        columns = self.inputs.columns
        return self.observation_dim if columns is None else len(columns)


class Agent(ABC):
    """An algorithm: a policy that explores, and an update from what it collected.

    Attributes:
        name: the algorithm's name, as `--algo` takes it.
        Config: dataclass of its options.
        actor: the network that is deployed.
        rollout_length: T, control steps of every environment between two updates.
        off_policy: may learn from rollouts of older policies: the next rollout can be
            collected while this one is learned from.
        imitates: needs the action of the task's expert, or of a trained policy, as
            `expert_action` [N, A] in each step.
        sees_images: its actor may see camera images (`Spaces.actor`).
        needs_preferences: learns from compared clips (`relabel`, `compare`), not from
            the environment's reward: needs a run with `--preferences`.
        image_copies: copies of each image in its replay buffer, to check the memory.
        takes_datasets: learns from recorded episodes (`--dataset`): as from an expert
            if it imitates, else they are given to `add_demonstrations`.
        has_native_gradients: its constructor takes the keyword `gradients`, "native" or
            "torchrl"; others always learn through TorchRL's losses and autograd.
        takes_device: its constructor takes the keyword `device`, on which it learns;
            others learn on the CPU.
    """

    name: ClassVar[str]
    Config: ClassVar[type[AgentConfig]]
    off_policy: ClassVar[bool] = False
    imitates: ClassVar[bool] = False
    sees_images: ClassVar[bool] = False
    image_copies: ClassVar[int] = 1
    takes_datasets: ClassVar[bool] = False
    needs_preferences: ClassVar[bool] = False
    has_native_gradients: ClassVar[bool] = False
    takes_device: ClassVar[bool] = False

    actor: Actor | BinnedActor | ImageActor
    rollout_length: int

    @abstractmethod
    def __init__(self, config: Any, spaces: Spaces, threads: int = 1) -> None:
        """Build the networks and their optimisers.

        Args:
            config: an instance of `Config`.
            spaces: sizes of observation and action.
            threads: the most threads that an update may use.
        """

    @abstractmethod
    def policy(self) -> TensorDictModuleBase:
        """Return a copy of the current policy that writes `action` [N, A] to its input.

        It has a separate random generator, because it may act while the agent learns.
        """

    def process_rollout(
        self, policy: TensorDictModuleBase, batch: TensorDictBase
    ) -> TensorDictBase:
        """Turn the policy's rollout [N, T] into what `update` takes.

        Runs on the thread that collected the rollout, while other threads may learn.
        """
        return batch

    def start_from(self, weights: Mapping[str, Tensor], deviation: float) -> None:
        """Start the actor from the weights of a trained one, before anything else.

        Args:
            weights: a state_dict of `actor`.
            deviation: standard deviation of the actions to begin with, as a fraction
                of each dimension's range; for algorithms whose actor has one.
        """
        self.actor.load_state_dict(weights)

    @abstractmethod
    def update(self, batch: TensorDictBase) -> dict[str, float]:
        """Learn from a rollout [N, T] (keys: manip.agents.trajectory).

        Returns:
            Scalars to log; empty before learning starts.
        """

    def add_demonstrations(self, rollouts: Sequence[TensorDictBase]) -> None:
        """Learn from recorded episodes, too; called before anything else.

        Args:
            rollouts: one [1, T] for each episode. By default they are ignored.
        """

    def store(self, batch: TensorDictBase) -> None:
        """Store a rollout [N, T] whose rewards are not known yet, if there is a buffer.

        Called instead of `update` until a run with preferences has learned a reward.
        """

    def relabel(self, reward: RewardFunction) -> None:
        """Replace the rewards of what is stored, after the learned reward has changed.

        By default nothing is stored.
        """

    def compare(self, pairs: ComparedClips) -> dict[str, float]:
        """Learn from all clips compared so far; called after `relabel`.

        Args:
            pairs: their steps are observation and action, joined.

        Returns:
            Scalars to log. By default nothing is learned.
        """
        return {}

    def waiting(self) -> str:
        """Prepare for the next rollout, and say what is still missing.

        Returns:
            What the run has to wait for, such as people's answers, in a line: the run
            saves and ends. Empty if it can go on.
        """
        return ""

    @abstractmethod
    def modules(self) -> dict[str, nn.Module]:
        """Return everything with parameters or buffers, by name, for checkpoints."""

    @abstractmethod
    def optimisers(self) -> dict[str, torch.optim.Optimizer]:
        """Return everything with optimiser state, by name, for checkpoints."""

    def extra_state(self, buffer: bool = True) -> dict[str, Any]:
        """Return tensors and numbers besides modules and optimisers, for checkpoints.

        Args:
            buffer: include the replay buffer, under the key "buffer"; None otherwise.
        """
        return {}

    def load_extra_state(self, state: dict[str, Any]) -> None:
        """Restore the state that `extra_state` returned.

        Raises:
            ValueError: the state is of other shapes.
        """
