"""Tasks as TorchRL environments: on the batch engine, and stepped by their libraries.

Keys, with N worlds: `observation` [N, D] float32 (see `TaskBatch.layout`), `action` [N, A]
in [-1, 1], `reward` [N, 1], `terminated` (the task failed, no future), `truncated`
(time is up: bootstrap through it), `done` (either), `success` [N, 1] bool,
`reward_terms` [N, K] float32 (names: worlds.reward_names), `milestones` [N, M] bool (names:
task.milestone_names), and if asked for `expert_action` [N, A], what the task's script would do.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from manip.envs.task_batch import TaskBatch, TimeStep

Array = np.ndarray


class TaskEnv(EnvBase):
    """TorchRL environment of a task batch.

    Args:
        batch: the environments.
        expert: whether each step gives the action of the task's expert, too.
    """

    batch_locked = True

    def __init__(self, worlds: TaskBatch, expert: bool = False) -> None:
        super().__init__(batch_size=[worlds.num_envs], device=None)
        self.batch = worlds
        self._expert = expert
        shape = self.batch_size
        width = max(part.stop for part in worlds.layout.values())
        milestones, terms = len(worlds.task.milestone_names), len(worlds.reward_names)
        flag = Binary(1, (*shape, 1), dtype=torch.bool)
        self.action_spec = Bounded(-1, 1, (*shape, worlds.action_dim))
        self.reward_spec = Unbounded((*shape, 1))
        self.observation_spec = Composite(
            observation=Unbounded((*shape, width)),
            success=flag,
            milestones=Binary(milestones, (*shape, milestones), dtype=torch.bool),
            reward_terms=Unbounded((*shape, terms)),
            shape=shape,
        )
        if expert:
            self.observation_spec["expert_action"] = self.action_spec.clone()
        ends = ("done", "terminated", "truncated")
        self.full_done_spec = Composite(
            {end: flag.clone() for end in ends}, shape=shape
        )

    def observe(self) -> TensorDictBase:
        """The worlds as they are now, as a reset returns them: nothing has ended."""
        return self._tensors(self.batch.observe())

    def _reset(
        self, tensordict: TensorDictBase | None = None, **_: Any
    ) -> TensorDictBase:
        worlds = np.arange(self.batch.num_envs)
        if tensordict is not None and "_reset" in tensordict.keys():
            worlds = np.flatnonzero(tensordict["_reset"].numpy())
        self.batch.begin(worlds)
        return self.observe()

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        time_step = self.batch.step(tensordict["action"].numpy())
        return self._tensors(time_step).set("reward", _columns([time_step.reward]))

    def _tensors(self, time_step: TimeStep) -> TensorDictBase:
        terms = [time_step.reward_terms[name] for name in self.batch.reward_names]
        milestones = [
            time_step.milestones[name] for name in self.batch.task.milestone_names
        ]
        found = {
            "observation": torch.from_numpy(time_step.observation),
            "reward_terms": _columns(terms),
            "success": torch.from_numpy(time_step.success[:, None]),
            "milestones": torch.from_numpy(np.stack(milestones, axis=1)),
            "terminated": torch.from_numpy(time_step.terminated[:, None]),
            "truncated": torch.from_numpy(time_step.truncated[:, None]),
            "done": torch.from_numpy(time_step.done[:, None]),
        }
        if self._expert:
            wanted = self.batch.expert().astype(np.float32)
            found["expert_action"] = torch.from_numpy(wanted)
        return TensorDict(found, self.batch_size)

    def _set_seed(self, seed: int | None) -> None:
        self.batch.restart(seed or 0)


def _columns(values: Iterable[Array]) -> torch.Tensor:
    return torch.from_numpy(np.stack(list(values), axis=1, dtype=np.float32))
