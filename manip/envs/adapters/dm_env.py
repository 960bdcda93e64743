"""Tasks as dm_env environments, observed in named parts."""

from typing import Any

import dm_env
import numpy as np
from dm_env import specs

from manip.envs.make_batch import Backend, make_batch
from manip.envs.time_step import TimeStep
from manip.sim.actions import batch_of_one

Array = np.ndarray


class TaskEnvironment(dm_env.Environment):
    """One environment of a task.

    An observation is a dict of the task's parts, [k] float32 each, and of the cameras'
    images, uint8 [H, W, C]. At the time limit the discount is 1, where the task failed
    it is 0.

    Args:
        task: name of the task, or package.module:Task.
        backend: "native" for the batch engine, "stock" for robosuite itself.
        options: as in `NativeBatch` or `StockBatch` (robot, horizon, seed, ...).

    Attributes:
        success: whether the goal is reached now.
    """

    def __init__(self, task: str, backend: Backend = "native", **options: Any) -> None:
        self.batch = make_batch(task, backend=backend, **options)
        self._over = True
        self.success = False

    def reset(self) -> dm_env.TimeStep:
        """Start the next episode."""
        self.batch.begin(np.zeros(1, np.int64))
        self._over = False
        return dm_env.restart(self._observation(self.batch.observe()))

    def step(self, action: Array) -> dm_env.TimeStep:
        """Take an action [A]; after the end of an episode, start the next."""
        if self._over:
            return self.reset()
        time_step = self.batch.step(batch_of_one(action, self.batch.action_dim))
        self._over = bool(time_step.done[0])
        observation = self._observation(time_step)
        reward = float(time_step.reward[0])
        if time_step.terminated[0]:
            return dm_env.termination(reward, observation)
        if time_step.truncated[0]:
            return dm_env.truncation(reward, observation)
        return dm_env.transition(reward, observation)

    def observation_spec(self) -> dict[str, specs.Array]:
        """Part name -> its shape and dtype."""
        return {
            part.name: specs.Array(part.shape, np.dtype(part.dtype), part.name)
            for part in self.batch.observation_spec.parts
        }

    def action_spec(self) -> specs.BoundedArray:
        """[A] in [-1, 1]."""
        shape = (self.batch.action_dim,)
        return specs.BoundedArray(shape, np.float32, -1.0, 1.0, "action")

    def _observation(self, time_step: TimeStep) -> dict[str, Array]:
        self.success = bool(time_step.success[0])
        images = {name: stack[0] for name, stack in time_step.images.items()}
        return self.batch.observation_spec.split(time_step.observation[0]) | images
