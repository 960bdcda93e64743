"""Rollouts and clips of Lift's expert, for tests of preferences."""

from dataclasses import replace

import numpy as np
import torch
from rollouts import actions
from tensordict import TensorDictBase

from manip.envs.adapters.torchrl import TaskEnv
from manip.envs.backends.native_batch import NativeBatch
from manip.envs.task_registry import load_task
from manip.preferences.clip_pool import cut_clips
from manip.preferences.clip_source import ClipSource
from manip.preferences.clips import Clip

LENGTH = 8


def recorded(
    name: str, steps: int = 24, num_envs: int = 3
) -> tuple[ClipSource, TensorDictBase]:
    """A rollout [N, T] of the noisy expert, in episodes of 20 steps.

    Its scene is built anew: with another cube than that of the tests' shared scene.
    """
    task = load_task(name)
    batch = NativeBatch(task, num_envs, threads=1, horizon=20, seed=5)
    env = TaskEnv(batch, expert=True, measures=True, states=True)
    noise = 0.3 * actions(steps, num_envs)
    state, rollout = env.reset(), []
    for move in noise:
        expert = state["expert_action"]
        state["action"] = (expert + move[:, : expert.shape[1]]).clamp(-1, 1)
        step, state = env.step_and_maybe_reset(state)
        rollout.append(step)
    return ClipSource.of(batch, name), torch.stack(rollout, 1)


def cut_all(source: ClipSource, rollout: TensorDictBase) -> list[Clip]:
    """Clips of LENGTH steps, environment by environment."""
    clips = cut_clips(rollout, LENGTH, source, "expert")
    return sorted(clips, key=lambda clip: (clip.header.env, clip.header.step))


def with_measures(clip: Clip, step: int, **values: float) -> Clip:
    """A copy with constant measures, at another step: another clip."""
    measures = clip.measures.copy()
    for name, value in values.items():
        measures[:, clip.header.measure_names.index(name)] = value
    return replace(
        clip, measures=np.float32(measures), header=replace(clip.header, step=step)
    )
