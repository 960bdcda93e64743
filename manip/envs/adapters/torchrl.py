"""Tasks as TorchRL environments.

Keys, with N environments::

    observation    [N, D] float32, joined parts (`TaskEnv.parts` names them)
    action         [N, A] float32 in [-1, 1]
    reward         [N, 1] float32
    terminated     [N, 1] bool, the task failed: there is no future
    truncated      [N, 1] bool, time is up: bootstrap through it
    done           [N, 1] bool, either
    success        [N, 1] bool
    reward_terms   [N, K] float32, named as `batch.reward_names`
    milestones     [N, M] bool, named as `batch.task.milestone_names`
    <camera>_image [N, H, W, C] uint8, a key for each camera
    measures       [N, V] float32, named as `batch.measure_names`, if requested
    expert_action  [N, A] float32, the action of the task's expert or of a given
                   policy in this state, if requested
    motion         what `batch.motion` returns, [N, k] float32 each, if requested
    states, ...    what `batch.record` returns, if requested
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from manip.arrays import is_tensor, namespace, on_host
from manip.envs.task_batch import TaskBatch
from manip.envs.time_step import TimeStep

Array = np.ndarray

Expert = Callable[[Mapping[str, torch.Tensor]], torch.Tensor]
"""Observation parts, name -> [N, ...], to action [N, A]."""


class TaskEnv(EnvBase):
    """TorchRL environment of a task batch.

    Args:
        batch: the environments.
        expert: whether each step gives the action of the task's expert, too; or the
            policy whose action it gives instead.
        measures: whether it gives the task's visible measures, too.
        states: whether it gives what `batch.record` returns, too.
        motion: whether it gives what `batch.motion` returns, too.

    Raises:
        UserError: the task has no expert, or the batch cannot record its states.
    """

    batch_locked = True

    def __init__(
        self,
        batch: TaskBatch,
        expert: bool | Expert = False,
        measures: bool = False,
        states: bool = False,
        motion: bool = False,
    ) -> None:
        super().__init__(batch_size=[batch.num_envs], device=None)
        self.batch = batch
        self._expert, self._measures, self._states = expert, measures, states
        self._motion = motion
        shape = self.batch_size
        dim = batch.observation_spec.dim
        milestones, terms = len(batch.task.milestone_names), len(batch.reward_names)
        flag = Binary(1, (*shape, 1), dtype=torch.bool)
        self.action_spec = Bounded(-1, 1, (*shape, batch.action_dim))
        self.reward_spec = Unbounded((*shape, 1))
        self.observation_spec = Composite(
            observation=Unbounded((*shape, dim)),
            success=flag,
            milestones=Binary(milestones, (*shape, milestones), dtype=torch.bool),
            reward_terms=Unbounded((*shape, terms)),
            shape=shape,
        )
        for part in batch.cameras.parts:
            self.observation_spec[part.name] = Bounded(
                0, 255, (*shape, *part.shape), dtype=torch.uint8
            )
        if measures:
            visible = Unbounded((*shape, len(batch.measure_names)))
            self.observation_spec["measures"] = visible
        for name, rows in (batch.record() if states else {}).items():
            kind = torch.from_numpy(rows).dtype
            self.observation_spec[name] = Unbounded(rows.shape, dtype=kind)
        if motion:
            named = batch.motion().items()
            kinds = {name: Unbounded(rows.shape) for name, rows in named}
            self.observation_spec["motion"] = Composite(kinds, shape=shape)
        if expert:
            self.observation_spec["expert_action"] = self.action_spec.clone()
        ends = ("done", "terminated", "truncated")
        self.full_done_spec = Composite(
            {end: flag.clone() for end in ends}, shape=shape
        )

    def parts(self, tensordict: TensorDictBase) -> dict[str, torch.Tensor]:
        """Part name -> view [..., k] of the joined observation, or images."""
        images = {part.name: tensordict[part.name] for part in self.batch.cameras.parts}
        return self.batch.observation_spec.split(tensordict["observation"]) | images

    def observe(self) -> TensorDictBase:
        """The present state as a reset returns it: no episode has ended."""
        return self._tensors(self.batch.observe())

    def _reset(
        self, tensordict: TensorDictBase | None = None, **_: Any
    ) -> TensorDictBase:
        env_ids = np.arange(self.batch.num_envs)
        if tensordict is not None and "_reset" in tensordict.keys():
            env_ids = np.flatnonzero(on_host(tensordict["_reset"]))
        self.batch.begin(env_ids)
        return self.observe()

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        action = tensordict["action"].detach()
        time_step = self.batch.step(
            action if self.batch.gives_tensors else action.numpy()
        )
        return self._tensors(time_step).set("reward", _columns([time_step.reward]))

    def _tensors(self, time_step: TimeStep) -> TensorDictBase:
        terms = [time_step.reward_terms[name] for name in self.batch.reward_names]
        milestones = [
            time_step.milestones[name] for name in self.batch.task.milestone_names
        ]
        tensors = {
            "observation": torch.as_tensor(time_step.observation),
            "reward_terms": _columns(terms),
            "success": torch.as_tensor(time_step.success[:, None]),
            "milestones": torch.as_tensor(_stacked(milestones)),
            "terminated": torch.as_tensor(time_step.terminated[:, None]),
            "truncated": torch.as_tensor(time_step.truncated[:, None]),
            "done": torch.as_tensor(time_step.done[:, None]),
        }
        for name, images in time_step.images.items():
            tensors[name] = torch.from_numpy(images)
        if self._measures:
            tensors["measures"] = torch.from_numpy(self.batch.measures())
        if self._motion:
            tensors["motion"] = self._motion_tensors()
        if self._states:
            recorded = self.batch.record().items()
            tensors |= {name: torch.from_numpy(rows) for name, rows in recorded}
        state = TensorDict(tensors, self.batch_size)
        if self._expert:
            state["expert_action"] = self._expert_action(state)
        return state

    def _motion_tensors(self) -> TensorDict:
        named = self.batch.motion().items()
        rows = {name: torch.from_numpy(v.astype(np.float32)) for name, v in named}
        return TensorDict(rows, self.batch_size)

    def _expert_action(self, state: TensorDictBase) -> torch.Tensor:
        if callable(self._expert):
            return self._expert(self.parts(state))
        return torch.from_numpy(self.batch.expert().astype(np.float32))

    def _set_seed(self, seed: int | None) -> None:
        self.batch.restart(seed or 0)


def _stacked(values: Sequence[Any]) -> Any:
    return namespace(values[0]).stack(values, axis=1)


def _columns(values: Sequence[Any]) -> torch.Tensor:
    if is_tensor(values[0]):
        return torch.stack([value.float() for value in values], 1)
    return torch.from_numpy(np.stack(values, axis=1, dtype=np.float32))
