"""Rollouts of TorchRL environments, for tests."""

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor

from manip.envs.adapters.torchrl import TaskEnv
from manip.envs.backends.native_batch import NativeBatch
from manip.envs.task import Task
from manip.sim.scene import Scene

Array = np.ndarray


def actions(
    steps: int, num_envs: int, seed: int = 0, scene: Scene | None = None
) -> Tensor:
    """[steps, N, 7] that do not depend on N in the environments they share.

    With a scene 7 numbers, or what the action takes if it is more.
    """
    size = max(7, scene.layout.action_dim if scene else 0)
    rngs = [np.random.default_rng([seed, env_id]) for env_id in range(num_envs)]
    drawn = [rng.uniform(-1, 1, (steps, size)).astype(np.float32) for rng in rngs]
    return torch.from_numpy(np.stack(drawn, axis=1))


def run(env, moves: Tensor) -> list[TensorDictBase]:
    """Reset, then steps [T] of `step_and_maybe_reset`, with `after`: what it acts on.

    Entries: those before the step, `next` after it, `after` once resets are done.
    """
    state, steps = env.reset(), []
    for move in moves:
        state["action"] = move[:, : env.action_spec.shape[-1]]
        step, state = env.step_and_maybe_reset(state)
        steps.append(step.clone().set("after", state.clone()))
    return steps


def stacked(steps: list[TensorDictBase], *key: str) -> Tensor:
    """[T, N, ...]."""
    return torch.stack([step[key] for step in steps])


def native(task: Task, scene: Scene, num_envs: int = 4, **options) -> TaskEnv:
    return TaskEnv(
        NativeBatch(task, num_envs, scene=scene, **({"threads": 1} | options))
    )
