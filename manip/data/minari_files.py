"""Minari data sets (minari.farama.org): observations as a Dict space of named parts.

Written by minari's own storage, read as plain HDF5. Images are stored upright, without
loss. infos: success [T + 1], and the actor's choices expert_action [T + 1] where noise
was added to the actions; their first rows belong to the reset.
"""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from manip.data.extra_libraries import library
from manip.data.hdf5_reading import MOST_EPISODES, SafeFile, open_hdf5
from manip.data.stored_episode import (
    MOST_JSON,
    Recording,
    StoredEpisode,
    read_recording,
)
from manip.errors import DamagedError, UserError, one_line
from manip.observation import ObservationPart

Array = np.ndarray

DATA, METADATA = "data/main_data.hdf5", "data/metadata.json"


def write_minari(
    folder: Path, recording: Recording, episodes: Iterator[StoredEpisode]
) -> Path:
    """Write the episodes into a folder; its part `data` appears once it is complete."""
    partial = folder.absolute() / ".partial-data"  # minari joins relative paths twice
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    storage = None
    for index, episode in enumerate(episodes):
        storage = storage or _new_storage(partial, recording, episode.action.shape[1])
        storage.update_episodes([_buffer(recording, episode, index)])
    if storage is not None:
        storage.update_metadata(_metadata(recording))
    partial.rename(folder / "data")
    return folder


def _new_storage(place: Path, recording: Recording, action_dim: int) -> Any:
    spaces = {part.name: _space(part) for part in recording.spec.parts}
    return library("minari.dataset.minari_storage").MinariStorage.new(
        place,
        gymnasium.spaces.Dict(spaces),
        gymnasium.spaces.Box(-1.0, 1.0, (action_dim,), np.float32),
        jpeg_encoding=False,
    )


def _space(part: ObservationPart) -> gymnasium.Space[Any]:
    if part.role == "camera":
        return gymnasium.spaces.Box(0, 255, part.shape, np.uint8)
    return gymnasium.spaces.Box(-np.inf, np.inf, part.shape, np.float32)


def _metadata(recording: Recording) -> dict[str, str]:
    name = "".join(c if c.isalnum() else "-" for c in recording.task).lower()
    return {
        "dataset_id": f"manip/{name}-v0",
        "minari_version": library("minari").__version__,
        "algorithm_name": recording.actor,
        "manip": recording.to_json(),
    }


def _buffer(recording: Recording, episode: StoredEpisode, index: int) -> Any:
    observations = dict(recording.spec.split(episode.observation))
    for name, pixels in episode.images.items():
        observations[name] = pixels[:, ::-1]
    last = np.arange(episode.steps) == episode.steps - 1
    infos = {"success": np.concatenate([[False], episode.success])}
    if recording.noise:
        infos["expert_action"] = np.vstack([0 * episode.label[:1], episode.label])
    return library("minari.data_collector.episode_buffer").EpisodeBuffer(
        id=index,
        observations=observations,
        actions=episode.action,
        rewards=episode.reward,
        terminations=last & episode.terminated,
        truncations=last & (not episode.terminated),
        infos=infos,
    )


def read_minari(folder: Path) -> tuple[Recording, list[StoredEpisode]]:
    """Read a data set that this project wrote.

    Raises:
        DamagedError: it is no such data set, or one of another origin.
    """
    recording = _recording(folder / METADATA)
    with open_hdf5(folder / DATA) as file:
        names = [name for name in file.names("") if name.startswith("episode_")]
        if not 0 < len(names) <= MOST_EPISODES:
            raise UserError(f"it holds {len(names)} episodes")
        return recording, [
            _read_episode(file, recording, f"episode_{index}")
            for index in range(len(names))
        ]


def _recording(path: Path) -> Recording:
    try:
        if path.stat().st_size > MOST_JSON:
            raise UserError(f"it is larger than {MOST_JSON} bytes")
        values = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(values, dict) or "manip" not in values:
            raise UserError(
                "another program recorded it: its observations are not those of a "
                "task here; use a robomimic file with states"
            )
        return read_recording(values["manip"])
    except (OSError, ValueError) as error:
        raise DamagedError(f"{path}: {one_line(error)}") from error


def _read_episode(file: SafeFile, recording: Recording, group: str) -> StoredEpisode:
    parts = {
        part.name: file.required(
            f"{group}/observations/{part.name}", 1 + len(part.shape)
        )
        for part in recording.spec.parts
    }
    action = file.required(f"{group}/actions", 2).astype(np.float32)
    label = action
    if recording.noise:
        label = file.required(f"{group}/infos/expert_action", 2)[1:].astype(np.float32)
    return StoredEpisode(
        observation=recording.spec.join(parts),
        action=action,
        label=label,
        reward=file.required(f"{group}/rewards", 1).astype(np.float32),
        success=file.required(f"{group}/infos/success", 1)[1:].astype(bool),
        terminated=bool(file.required(f"{group}/terminations", 1).any()),
        images={name: parts[name][:, ::-1].copy() for name in recording.cameras},
    )
