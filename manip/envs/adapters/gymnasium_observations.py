"""Observations of a task batch as Gymnasium's spaces and values.

Without cameras an observation is the joined vector [D] float32. With cameras it is a
dict: the numbers [k] float32 of each role ("proprioception", and "object", which only a
simulator knows), and each camera part, uint8 [H, W, C]. `FilterObservation` of
Gymnasium leaves entries out.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Dict, Space

from manip.cameras import CameraConfig
from manip.envs.task_batch import TaskBatch
from manip.envs.time_step import TimeStep

Array = np.ndarray

Observation = Array | dict[str, Array]

_OPTIONS = {"image_size": "size", "image_quality": "quality", "frames": "frames"}
"""Option -> field of `CameraConfig`."""


def with_cameras(options: Mapping[str, Any]) -> dict[str, Any]:
    """Replace the names of cameras and their options by a `CameraConfig`.

    Raises:
        UserError: a value is out of its range.
    """
    given = {key: options[name] for name, key in _OPTIONS.items() if name in options}
    others = {name: options[name] for name in options if name not in _OPTIONS}
    cameras = others.get("cameras") or ()
    if not isinstance(cameras, CameraConfig):
        others["cameras"] = CameraConfig(cameras, **given)
    return others


def observation_space(batch: TaskBatch) -> Box | Dict:
    """The space of one environment's observation."""
    if not batch.cameras.names:
        return _numbers(batch.observation_spec.dim)
    spaces: dict[str, Space[Any]] = {
        role: _numbers(len(columns)) for role, columns in _roles(batch).items()
    }
    for part in batch.cameras.parts:
        spaces[part.name] = Box(0, 255, part.shape, np.uint8)
    return Dict(spaces)


def observations(batch: TaskBatch, time_step: TimeStep) -> Observation:
    """The observation of all environments, each entry [N, ...]."""
    if not batch.cameras.names:
        return time_step.observation
    roles = {
        role: time_step.observation[:, columns]
        for role, columns in _roles(batch).items()
    }
    return roles | dict(time_step.images)


def observation_of(batch: TaskBatch, time_step: TimeStep, env_id: int) -> Observation:
    """The observation of one environment."""
    batched = observations(batch, time_step)
    if isinstance(batched, dict):
        return {name: values[env_id] for name, values in batched.items()}
    one: Array = batched[env_id]
    return one


def _numbers(size: int) -> Box:
    return Box(-np.inf, np.inf, (size,), np.float32)


def _roles(batch: TaskBatch) -> dict[str, Array]:
    """Role -> columns [k] of the joined vector that have it."""
    spec, numbers = batch.observation_spec, np.arange(batch.observation_spec.dim)
    columns: dict[str, list[Array]] = {}
    for part in spec.parts:
        if part.role != "camera":
            columns.setdefault(part.role, []).append(numbers[spec.slices[part.name]])
    return {role: np.concatenate(parts) for role, parts in columns.items()}
