"""Environments that are stepped in another process, which may be lost."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol

import torch
from tensordict.nn import TensorDictModuleBase

from manip.envs.adapters.torchrl import TaskEnv
from manip.envs.faults import Fault
from manip.errors import UserError
from manip.training.build import training_env
from manip.training.collector import Rollout
from manip.training.config import TrainConfig
from manip.training.experience import Experience, experience_of, plain
from manip.training.waypoints import add_waypoints

MOST_LOSSES = 5
"""Processes that are lost one after another before a run gives up."""

State = dict[str, Any]
"""What `Rollout.save_state` returns."""


class LostError(Exception):
    """The process of a collector, or its machine, was lost."""


@dataclass(frozen=True)
class Collected:
    """A rollout of another process.

    Attributes:
        experience: the rollout, as plain values.
        state: of the environments after it.
        faults: of the environments in it.
    """

    experience: dict[str, Any]
    state: State
    faults: list[Fault]


class Collecting(Protocol):
    """A process that steps a group of environments."""

    def collect(
        self, policy: TensorDictModuleBase, length: int, state: State | None
    ) -> Collected:
        """Collect a rollout, from a state if one is given.

        Raises:
            LostError: the process is lost.
        """


class CollectorProcess:
    """What runs in the other process: a group of a run's environments.

    Args:
        config: options of the run.
        group, groups: the group, and their number.
    """

    def __init__(self, config: TrainConfig, group: int, groups: int) -> None:
        torch.set_num_threads(1)
        config = replace(config, threads=1)
        self._env = training_env(config, group, groups)
        add_waypoints(config, [self._env])
        self._env.batch.dump_folder = None  # the run folder is on another machine
        self._rollout = Rollout(self._env)

    def collect(
        self, policy: TensorDictModuleBase, length: int, state: State | None
    ) -> Collected:
        """Collect a rollout; see `Collecting`."""
        if state is not None:
            self._rollout.load_state(state)
        experience = plain(self._rollout.collect(policy, length))
        faults = [*self._env.batch.faults]
        self._env.batch.faults.clear()
        return Collected(experience, self._rollout.save_state(), faults)


class RemoteRollout:
    """A `RolloutSource` in another process; a lost one is replaced.

    The environments then go on from their state before the rollout that was lost, with
    the same policy, so that the run is the same.

    Args:
        env: environments like those of the other process, for their shapes and faults.
            They are never stepped.
        start: starts a process.
        name: of the collector, for messages.
    """

    def __init__(
        self, env: TaskEnv, start: Callable[[], Collecting], name: str
    ) -> None:
        self.messages: deque[str] = deque()
        self._env, self._start, self._name = env, start, name
        self._like = Rollout(env)
        self._state = self._like.save_state()
        self._process: Collecting | None = None

    def collect(self, policy: TensorDictModuleBase, length: int) -> Experience:
        """Step all environments `length` times; the batch is [N, T].

        Raises:
            UserError: the process is lost again and again.
        """
        for _ in range(MOST_LOSSES):
            try:
                return self._stored(self._collected(policy, length))
            except LostError as error:
                self._process = None
                self.messages.append(f"{self._name} was lost and is replaced: {error}")
        raise UserError(f"{self._name} was lost {MOST_LOSSES} times")

    def _collected(self, policy: TensorDictModuleBase, length: int) -> Collected:
        if self._process is None:
            self._process = self._start()
            return self._process.collect(policy, length, self._state)
        return self._process.collect(policy, length, None)

    def _stored(self, collected: Collected) -> Experience:
        self._state = collected.state
        batch = self._env.batch
        batch.faults.extend(collected.faults)
        batch.fault_count = int(collected.state["env"]["fault_count"])
        return experience_of(collected.experience)

    def example(self, policy: TensorDictModuleBase, length: int) -> Experience:
        """An experience of zeros with the keys, shapes and dtypes of `collect`'s."""
        return self._like.example(policy, length)

    def save_state(self) -> State:
        """State of the environments and episodes after the latest `collect`."""
        return self._state

    def load_state(self, state: State) -> None:
        """Restore what `save_state` returned.

        Raises:
            ValueError: the state is of other environments.
        """
        self._like.load_state(state)
        self._state, self._process = self._like.save_state(), None
