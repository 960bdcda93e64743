"""robomimic's HDF5 files (github.com/ARISE-Initiative/robomimic).

data.attrs: total, env_args (JSON), manip (JSON, see `Recording`); for each episode a
group data/demo_<i> with num_samples, model_file (MJCF) and the arrays states
[T, 1 + nq + nv], actions [T, A], rewards [T], dones [T], and in obs and next_obs the
parts of the observation, images upright. This project adds successes [T], fields, and
the actor's choices expert_actions [T, A] where noise was added to the actions.
"""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from manip.data.extra_libraries import library
from manip.data.hdf5_reading import MOST_EPISODES, SafeFile, open_hdf5
from manip.data.stored_episode import (
    MOST_JSON,
    Recording,
    StoredEpisode,
    read_recording,
)
from manip.errors import UserError
from manip.io.atomic_files import replace_file
from manip.observation import ObservationSpec
from manip.versions import versions

Array = np.ndarray

FILE = "demo.hdf5"
"""Name of the file in the folder of a recording."""

ROBOSUITE = 1
"""robomimic's number of the kind of environment (envs/env_base.py)."""

DEMO = re.compile(r"demo_\d{1,9}")


def write_robomimic(
    folder: Path, recording: Recording, episodes: Iterator[StoredEpisode]
) -> Path:
    """Write the episodes into a file in a folder, atomically; return its path."""
    h5py, path = library("h5py"), folder / FILE

    def write(temporary: Path) -> None:
        with h5py.File(temporary, "w", libver="latest") as file:
            data, total = file.create_group("data"), 0
            for index, episode in enumerate(episodes):
                _write_episode(data.create_group(f"demo_{index}"), recording, episode)
                total += episode.steps
            data.attrs["total"] = total
            data.attrs["env_args"] = json.dumps(_env_args(recording))
            data.attrs["manip"] = recording.to_json()

    replace_file(path, write)
    return path


def _write_episode(group: Any, recording: Recording, episode: StoredEpisode) -> None:
    if episode.states is None:
        raise UserError(
            f"--format robomimic needs states of robosuite, which {recording.task} "
            "does not give: choose lerobot or minari"
        )
    group.attrs["num_samples"] = episode.steps
    group.attrs["model_file"] = episode.model
    dones = np.zeros(episode.steps, np.int64)
    dones[-1] = 1
    group["states"] = episode.states[:-1]
    group["last_state"] = episode.states[-1]
    group["actions"] = episode.action.astype(np.float64)
    group["rewards"] = episode.reward.astype(np.float64)
    group["dones"] = dones
    group["successes"] = episode.success
    group["terminated"] = np.array([episode.terminated])
    if recording.noise:
        group["expert_actions"] = episode.label.astype(np.float64)
    for name, values in episode.fields.items():
        group[f"fields/{name}"] = values
    for name, values in recording.spec.split(episode.observation).items():
        group[f"obs/{name}"], group[f"next_obs/{name}"] = values[:-1], values[1:]
    for name, pixels in episode.images.items():
        upright = pixels[:, ::-1]
        for place, images in (("obs", upright[:-1]), ("next_obs", upright[1:])):
            group.create_dataset(f"{place}/{name}", data=images, compression="gzip")


def _env_args(recording: Recording) -> dict[str, Any]:
    """What robomimic builds the environment from: robosuite.make's arguments."""
    from manip.envs.task_registry import load_task

    return {
        "env_name": load_task(recording.task).robosuite_name,
        "env_version": versions()["robosuite"],
        "type": ROBOSUITE,
        "env_kwargs": {
            "robots": [recording.robot],
            "control_freq": recording.control_freq,
            "has_renderer": False,
            "has_offscreen_renderer": bool(recording.cameras),
            "use_camera_obs": bool(recording.cameras),
            "reward_shaping": True,
        },
    }


def read_robomimic(path: Path) -> tuple[Recording, list[StoredEpisode]]:
    """Read a file.

    Returns:
        The recording, and its episodes. That of a file of another origin names the
        robosuite environment as its task, and has no observation: the observations of
        its episodes have width 0, and `manip.data.restored` computes them from states.

    Raises:
        DamagedError: it is no such file, or an array does not fit.
    """
    with open_hdf5(path) as file:
        text = file.text("data", "manip")
        recording = read_recording(text) if text else _foreign(file)
        names = [name for name in file.names("data") if DEMO.fullmatch(name)]
        if not 0 < len(names) <= MOST_EPISODES:
            raise UserError(f"it holds {len(names)} episodes as data/demo_<number>")
        names.sort(key=lambda name: int(name.removeprefix("demo_")))
        spec = recording.spec
        return recording, [_read_episode(file, f"data/{n}", spec) for n in names]


def _foreign(file: SafeFile) -> Recording:
    """What a file of another origin is of, from its env_args.

    Raises:
        UserError: it does not say which robosuite environment and arm.
    """
    try:
        args = json.loads(file.text("data", "env_args")[:MOST_JSON])
        options = args["env_kwargs"]
        robots = options["robots"]
        robot = robots if isinstance(robots, str) else robots[0]
        frequency = int(options.get("control_freq", 20))
        return Recording(
            str(args["env_name"]), str(robot), "OSC_POSE", frequency, "", []
        )
    except (json.JSONDecodeError, RecursionError, KeyError, TypeError, IndexError):
        raise UserError(
            "its env_args do not name a robosuite environment and robots"
        ) from None


def _read_episode(file: SafeFile, group: str, spec: ObservationSpec) -> StoredEpisode:
    action = file.required(f"{group}/actions", 2).astype(np.float32)
    steps = len(action)
    states, last = (
        file.array(f"{group}/states", 2),
        file.array(f"{group}/last_state", 1),
    )
    label = file.array(f"{group}/expert_actions", 2)
    terminated = file.array(f"{group}/terminated", 1)
    success = file.array(f"{group}/successes", 1)
    reward = file.array(f"{group}/rewards", 1)
    names = file.names(f"{group}/fields")
    fields = {name: file.required(f"{group}/fields/{name}", 1) for name in names}
    return StoredEpisode(
        observation=_observation(file, group, spec, steps),
        action=action,
        label=action if label is None else label.astype(np.float32),
        reward=_or_zeros(reward, steps).astype(np.float32),
        success=_or_zeros(success, steps).astype(bool),
        terminated=terminated is not None and bool(terminated.any()),
        images={
            part.name: _images(file, group, part.name, steps)
            for part in spec.parts
            if part.role == "camera"
        },
        states=states if last is None or states is None else np.vstack([states, last]),
        fields=fields,
    )


def _or_zeros(values: Array | None, steps: int) -> Array:
    return np.zeros(steps) if values is None else values


def _observation(
    file: SafeFile, group: str, spec: ObservationSpec, steps: int
) -> Array:
    """[T + 1, D]: all parts but cameras, joined; [T + 1, 0] without a specification."""
    if not spec.slices:
        return np.zeros((steps + 1, 0), np.float32)
    parts = {}
    for part in spec.parts:
        if part.role != "camera":
            axes = 1 + len(part.shape)
            now = file.required(f"{group}/obs/{part.name}", axes)
            after = file.required(f"{group}/next_obs/{part.name}", axes)
            parts[part.name] = np.concatenate([now, after[-1:]])
            if parts[part.name].shape != (steps + 1, *part.shape):
                raise UserError(f"{group}/obs/{part.name} has shape {now.shape}")
    return spec.join(parts)


def _images(file: SafeFile, group: str, name: str, steps: int) -> Array:
    now = file.required(f"{group}/obs/{name}", 4)
    after = file.required(f"{group}/next_obs/{name}", 4)
    return np.concatenate([now, after[-1:]])[:, ::-1].copy()
