"""Ranges of a task's observations and rewards, under its expert and at random."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from manip.envs.backends.native_batch import NativeBatch
from manip.envs.task import Task
from manip.evaluation.episodes import HELD_STEPS
from manip.evaluation.statistics import Rate, success_rate
from manip.sim.scene import Scene

Array = np.ndarray


@dataclass(frozen=True)
class TaskRanges:
    """Numbers of T steps of native episodes, the expert's first.

    Attributes:
        observations: part -> [T, k].
        terms: reward term of the shaped set -> [T], raw.
        reward: [T], the weighted sum.
        expert_steps: how many of the T steps are the expert's.
        expert_success: success_held of the expert's episodes; None without an expert.
    """

    observations: dict[str, Array]
    terms: dict[str, Array]
    reward: Array
    expert_steps: int
    expert_success: Rate | None


def measure_ranges(task: Task, scene: Scene, episodes: int) -> TaskRanges:
    """Run episodes of the expert, if there is one, and as many of random actions."""
    batch = NativeBatch(task, episodes, scene=scene)
    generator = np.random.default_rng(0)
    shape = episodes, batch.action_dim
    success: Rate | None = None
    steps: list[dict[str, Array]] = []
    if type(task).expert is not Task.expert:
        steps, streak = _episodes(batch, lambda: batch.expert())
        success = success_rate(list(streak >= HELD_STEPS))
    expert_steps = len(steps) * episodes
    steps += _episodes(batch, lambda: generator.uniform(-1, 1, shape))[0]
    joined = {name: np.concatenate([s[name] for s in steps]) for name in steps[0]}
    parts = batch.observation_spec.split(joined.pop("observation"))
    reward = joined.pop("reward")
    return TaskRanges(parts, joined, reward, expert_steps, success)


def _episodes(
    batch: NativeBatch, act: Callable[[], Array]
) -> tuple[list[dict[str, Array]], Array]:
    """The next episode of all environments: steps, and successes in a row at the end.

    An episode that fails before its end goes on, as nothing else is compared with it.
    """
    batch.begin(np.arange(batch.num_envs))
    steps, streak = [], np.zeros(batch.num_envs, int)
    for _ in range(batch.horizon):
        step = batch.step(act())
        named = {"observation": step.observation, "reward": step.reward}
        steps.append({**named, **step.reward_terms})
        streak = np.where(step.success, streak + 1, 0)
    return steps, streak
