"""Paths and features of a LeRobotDataset v3 (github.com/huggingface/lerobot)."""

from typing import Any

import numpy as np

from manip.cameras import part_name
from manip.data.stored_episode import Recording

VERSION = "v3.0"
SIZES = {"data_files_size_in_mb": 100, "video_files_size_in_mb": 200}
CHUNK = 1000
"""Files in a chunk."""

DATA = "data/chunk-{chunk:03d}/file-{file:03d}.parquet"
VIDEO = "videos/{key}/chunk-{chunk:03d}/file-{file:03d}.mp4"
EPISODES = "meta/episodes/chunk-000/file-000.parquet"
TASKS, INFO, STATS = "meta/tasks.parquet", "meta/info.json", "meta/stats.json"

STATE, OBJECTS = "observation.state", "observation.environment_state"
LABEL = "action.expert"
"""What the actor had chosen, where noise was added to the action."""
REWARD, SUCCESS, DONE = "next.reward", "next.success", "next.done"

INDICES = {
    "timestamp": "float32",
    **dict.fromkeys(("frame_index", "episode_index", "index", "task_index"), "int64"),
}


def image_key(part: str) -> str:
    """Feature of a camera's part: observation.images.<camera>."""
    return f"observation.images.{part.removesuffix(part_name(''))}"


def file_path(template: str, file: int, **names: str) -> str:
    """Path of the file of a number, in its chunk."""
    return template.format(chunk=file // CHUNK, file=file % CHUNK, **names)


def vector_parts(recording: Recording) -> dict[str, list[str]]:
    """Feature -> the parts of the observation that it joins."""
    parts = [part for part in recording.spec.parts if part.role != "camera"]
    own = [part.name for part in parts if part.role == "proprioception"]
    others = [part.name for part in parts if part.name not in own]
    return {key: names for key, names in ((STATE, own), (OBJECTS, others)) if names}


def features_of(recording: Recording, action_width: int) -> dict[str, dict[str, Any]]:
    """Feature -> dtype, shape and names of its numbers."""
    sizes = {p.name: int(np.prod(p.shape)) for p in recording.spec.parts}
    features: dict[str, dict[str, Any]] = {}
    for key, parts in vector_parts(recording).items():
        names = [f"{part}.{i}" for part in parts for i in range(sizes[part])]
        features[key] = _feature("float32", len(names), names)
    for part in recording.spec.parts:
        if part.role == "camera":
            features[image_key(part.name)] = {
                "dtype": "video",
                "shape": list(part.shape),
                "names": ["height", "width", "channels"],
            }
    features["action"] = _feature("float32", action_width)
    if recording.noise:
        features[LABEL] = _feature("float32", action_width)
    features[REWARD] = _feature("float32", 1)
    features |= {key: _feature("bool", 1) for key in (SUCCESS, DONE)}
    return features | {key: _feature(kind, 1) for key, kind in INDICES.items()}


def _feature(dtype: str, width: int, names: list[str] | None = None) -> dict[str, Any]:
    return {"dtype": dtype, "shape": [width], "names": names}
