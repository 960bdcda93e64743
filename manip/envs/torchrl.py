"""Tasks as TorchRL environments: on the batch engine, and stepped by their libraries.

Keys, with N worlds: `observation` [N, D] float32 (see `Worlds.layout`), `action` [N, A]
in [-1, 1], `reward` [N, 1], `terminated` (the task failed, no future), `truncated`
(time is up: bootstrap through it), `done` (either), `success` [N, 1] bool,
`reward_terms` [N, K] float32 (names: worlds.reward_names), `stages` [N, M] bool (names:
task.stages), and if asked for `script` [N, A], what the task's script would do.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from manip.envs.native import NativeWorlds
from manip.envs.others import OtherTask, OtherWorlds
from manip.envs.stock import StockWorlds
from manip.envs.task import Task
from manip.envs.worlds import Moment, Worlds

Array = np.ndarray


class TaskEnv(EnvBase):
    """TorchRL environment of worlds, which it keeps as `worlds`."""

    batch_locked = True

    def __init__(self, worlds: Worlds, script: bool = False) -> None:
        super().__init__(batch_size=[worlds.num_worlds], device=None)
        self.worlds = worlds
        self._script = script
        shape = self.batch_size
        width = max(part.stop for part in worlds.layout.values())
        stages, terms = len(worlds.task.stages), len(worlds.reward_names)
        flag = Binary(1, (*shape, 1), dtype=torch.bool)
        self.action_spec = Bounded(-1, 1, (*shape, worlds.action_dim))
        self.reward_spec = Unbounded((*shape, 1))
        self.observation_spec = Composite(
            observation=Unbounded((*shape, width)),
            success=flag,
            stages=Binary(stages, (*shape, stages), dtype=torch.bool),
            reward_terms=Unbounded((*shape, terms)),
            shape=shape,
        )
        if script:
            self.observation_spec["script"] = self.action_spec.clone()
        ends = ("done", "terminated", "truncated")
        self.full_done_spec = Composite(
            {end: flag.clone() for end in ends}, shape=shape
        )

    def look(self) -> TensorDictBase:
        """The worlds as they are now, as a reset returns them: nothing has ended."""
        return self._tensors(self.worlds.look())

    def _reset(
        self, tensordict: TensorDictBase | None = None, **_: Any
    ) -> TensorDictBase:
        worlds = np.arange(self.worlds.num_worlds)
        if tensordict is not None and "_reset" in tensordict.keys():
            worlds = np.flatnonzero(tensordict["_reset"].numpy())
        self.worlds.begin(worlds)
        return self.look()

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        moment = self.worlds.step(tensordict["action"].numpy())
        return self._tensors(moment).set("reward", _columns([moment.reward]))

    def _tensors(self, moment: Moment) -> TensorDictBase:
        terms = [moment.reward_terms[name] for name in self.worlds.reward_names]
        stages = [moment.stages[name] for name in self.worlds.task.stages]
        found = {
            "observation": torch.from_numpy(moment.observation),
            "reward_terms": _columns(terms),
            "success": torch.from_numpy(moment.success[:, None]),
            "stages": torch.from_numpy(np.stack(stages, axis=1)),
            "terminated": torch.from_numpy(moment.terminated[:, None]),
            "truncated": torch.from_numpy(moment.truncated[:, None]),
            "done": torch.from_numpy(moment.done[:, None]),
        }
        if self._script:
            wanted = self.worlds.script().astype(np.float32)
            found["script"] = torch.from_numpy(wanted)
        return TensorDict(found, self.batch_size)

    def _set_seed(self, seed: int | None) -> None:
        self.worlds.restart(seed or 0)


class NativeEnv(TaskEnv):
    """TorchRL environment of a task on the batch engine.

    Args:
        task: what is to be done.
        num_worlds: N.
        script: whether to say what the task's script would do.
        options: as in `manip.envs.native.NativeWorlds`.
    """

    worlds: NativeWorlds

    def __init__(
        self, task: Task, num_worlds: int, script: bool = False, **options: Any
    ) -> None:
        super().__init__(NativeWorlds(task, num_worlds, **options), script)


class OtherEnv(TaskEnv):
    """TorchRL environment of another library's task, stepped by that library.

    Args:
        task: what is to be done.
        num_worlds: N.
        script: as in `NativeEnv`.
        options: as in `manip.envs.others.OtherWorlds`.
    """

    worlds: OtherWorlds

    def __init__(
        self, task: OtherTask, num_worlds: int, script: bool = False, **options: Any
    ) -> None:
        super().__init__(OtherWorlds(task, num_worlds, **options), script)


class StockEnv(TaskEnv):
    """TorchRL environment of a task that steps `robosuite.make(...)` itself.

    Args:
        task: what is to be done.
        options: as in `manip.envs.stock.StockWorlds`.
    """

    worlds: StockWorlds

    def __init__(self, task: Task, **options: Any) -> None:
        super().__init__(StockWorlds(task, **options))


def _columns(values: Iterable[Array]) -> torch.Tensor:
    return torch.from_numpy(np.stack(list(values), axis=1, dtype=np.float32))
