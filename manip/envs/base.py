"""The TorchRL environment of a task, whatever steps its worlds.

Keys, with N worlds: `observation` [N, D] float32 (see `layout`), `action` [N, A] in
[-1, 1], `reward` [N, 1], `terminated` (the task failed, no future), `truncated` (time
is up: bootstrap through it), `done` (either), `success` [N, 1] bool, `reward_terms`
[N, K] float32 (names in `reward_names`), `stages` [N, M] bool (names: task.stages).
"""

from abc import abstractmethod
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from manip.envs.task import Measures, Task
from manip.rewards.compose import weighted_sum
from manip.sim.stock import check_choice

Array = np.ndarray


class TaskEnv(EnvBase):
    """Base of the native and the stock environment; subclasses move the worlds.

    Args:
        task: what is to be done.
        num_worlds: N.
        action_dim: A.
        horizon: episode length [control steps]; the task's own unless given.
        reward: which of the task's reward sets is paid, "shaped" or "stock".
        seed: of all episodes; episode e of world w depends on (seed, w, e) only.

    Attributes:
        layout: observation part -> slice of the observation vector.
        elapsed: [N] control steps since each world's episode began.
    """

    batch_locked = True

    def __init__(
        self,
        task: Task,
        num_worlds: int,
        action_dim: int,
        horizon: int | None,
        reward: str,
        seed: int,
    ) -> None:
        super().__init__(batch_size=[num_worlds], device=None)
        check_choice("reward", reward, tuple(task.weights))
        self.task = task
        self.horizon = horizon or task.horizon
        self.reward_set = reward
        self.seed = seed
        self.elapsed = np.zeros(num_worlds, dtype=np.int64)
        self.episode = np.full(num_worlds, -1, dtype=np.int64)
        parts = task.observe(task.measure(self._read()))
        self.layout = _layout(parts)
        self.reward_names = tuple(task.weights[reward])
        self._make_specs(sum(part.shape[1] for part in parts.values()), action_dim)

    @abstractmethod
    def _read(self) -> Measures:
        """Current readings of all worlds."""

    @abstractmethod
    def _start_episodes(self, worlds: Array) -> None:
        """Put the given worlds at the start of their episode `self.episode[worlds]`."""

    @abstractmethod
    def _move(self, action: Array) -> Array:
        """Advance all worlds by one control step; [N] bool, the worlds that broke."""

    def _make_specs(self, width: int, action_dim: int) -> None:
        shape = self.batch_size
        self.action_spec = Bounded(-1, 1, (*shape, action_dim), dtype=torch.float32)
        self.reward_spec = Unbounded((*shape, 1))
        self.observation_spec = Composite(
            observation=Unbounded((*shape, width)),
            success=Binary(1, (*shape, 1), dtype=torch.bool),
            stages=Binary(
                len(self.task.stages), (*shape, len(self.task.stages)), dtype=torch.bool
            ),
            reward_terms=Unbounded((*shape, len(self.reward_names))),
            shape=shape,
        )
        flag = Binary(1, (*shape, 1), dtype=torch.bool)
        ends = ("done", "terminated", "truncated")
        self.full_done_spec = Composite(
            {end: flag.clone() for end in ends}, shape=shape
        )

    def _reset(
        self, tensordict: TensorDictBase | None = None, **_: Any
    ) -> TensorDictBase:
        worlds = np.arange(self.num_worlds)
        if tensordict is not None and "_reset" in tensordict.keys():
            worlds = np.flatnonzero(tensordict["_reset"].numpy())
        self.episode[worlds] += 1
        self.elapsed[worlds] = 0
        if len(worlds):
            self._start_episodes(worlds)
        return self.look()

    def look(self) -> TensorDictBase:
        """The worlds as they are now, as a reset returns them: nothing has ended."""
        found = self._look()
        del found["reward"], found["failed"]
        never = torch.zeros(*self.batch_size, 1, dtype=torch.bool)
        ends = {end: never.clone() for end in ("done", "terminated", "truncated")}
        return TensorDict({**found, **ends}, self.batch_size)

    def restart(self) -> None:
        """Begin anew: the next reset starts every world's first episode again."""
        self.episode[:] = -1

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        broken = self._move(tensordict["action"].numpy())
        self.elapsed += 1
        found = self._look()
        terminated = found.pop("failed")
        over = torch.from_numpy((self.elapsed >= self.horizon) | broken).unsqueeze(-1)
        truncated = over & ~terminated
        ends = {
            "terminated": terminated,
            "truncated": truncated,
            "done": terminated | truncated,
        }
        return TensorDict({**found, **ends}, self.batch_size)

    def _look(self) -> dict[str, torch.Tensor]:
        """Everything that is said of the worlds as they are now."""
        task = self.task
        m = task.measure(self._read())
        terms = task.reward_terms(m, self.reward_set)
        reached = task.reached(m)
        return {
            "observation": _joined(task.observe(m).values()),
            "reward": _column(weighted_sum(terms, task.weights[self.reward_set])),
            "reward_terms": _joined(
                [terms[name][:, None] for name in self.reward_names]
            ),
            "success": torch.from_numpy(task.success(m)[:, None]),
            "stages": torch.from_numpy(np.stack([reached[s] for s in task.stages], 1)),
            "failed": torch.from_numpy(task.failure(m)[:, None]),
        }

    def _set_seed(self, seed: int | None) -> None:
        self.seed = seed or 0
        self.restart()

    @property
    def num_worlds(self) -> int:
        """N, the number of worlds."""
        return self.batch_size[0]


def _layout(parts: dict[str, Array]) -> dict[str, slice]:
    layout, at = {}, 0
    for name, part in parts.items():
        layout[name] = slice(at, at + part.shape[1])
        at += part.shape[1]
    return layout


def _joined(parts: Any) -> torch.Tensor:
    return torch.from_numpy(np.concatenate(list(parts), axis=1, dtype=np.float32))


def _column(values: Array) -> torch.Tensor:
    return torch.from_numpy(values.astype(np.float32)[:, None])
