"""Tasks as dm_env environments: one world, observed in named parts."""

from typing import Any

import dm_env
import numpy as np
from dm_env import specs

from manip.envs.make_batch import Backend, make_batch
from manip.envs.task_batch import TimeStep

Array = np.ndarray


class TaskEnvironment(dm_env.Environment):
    """One world of a task.

    An observation is a dict of the task's parts, [k] float32 each. At the time limit
    the discount is 1, where the task failed it is 0.

    Args:
        task: name of the task, or package.module:Task.
        backend: "native" for the batch engine, "stock" for robosuite itself.
        options: as in `NativeBatch` or `StockBatch` (robot, horizon, seed, ...).

    Attributes:
        success: whether the goal holds now.
    """

    def __init__(self, task: str, backend: Backend = "native", **options: Any) -> None:
        self._worlds = make_batch(task, backend=backend, **options)
        self._over = True
        self.success = False

    def reset(self) -> dm_env.TimeStep:
        """Start the next episode."""
        self._worlds.begin(np.zeros(1, np.int64))
        self._over = False
        return dm_env.restart(self._observation(self._worlds.observe()))

    def step(self, action: Array) -> dm_env.TimeStep:
        """Take an action [A]; after the end of an episode, start the next."""
        if self._over:
            return self.reset()
        time_step = self._worlds.step(np.asarray(action)[None])
        self._over = bool(time_step.done[0])
        found, reward = self._observation(time_step), float(time_step.reward[0])
        if time_step.terminated[0]:
            return dm_env.termination(reward, found)
        if time_step.truncated[0]:
            return dm_env.truncation(reward, found)
        return dm_env.transition(reward, found)

    def observation_spec(self) -> dict[str, specs.Array]:
        """Part -> its shape."""
        return {
            name: specs.Array((part.stop - part.start,), np.float32, name)
            for name, part in self._worlds.layout.items()
        }

    def action_spec(self) -> specs.BoundedArray:
        """[A] in [-1, 1]."""
        shape = (self._worlds.action_dim,)
        return specs.BoundedArray(shape, np.float32, -1.0, 1.0, "action")

    def _observation(self, time_step: TimeStep) -> dict[str, Array]:
        self.success = bool(time_step.success[0])
        layout = self._worlds.layout.items()
        return {name: time_step.observation[0, part] for name, part in layout}
