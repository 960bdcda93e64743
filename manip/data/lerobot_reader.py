"""Read a LeRobotDataset v3 that this project wrote.

Paths that the files name are not followed: data and videos lie where v3 puts them.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np

from manip.data import lerobot_layout as layout
from manip.data.extra_libraries import library
from manip.data.hdf5_reading import MOST_BYTES, MOST_EPISODES
from manip.data.lerobot_layout import file_path, image_key
from manip.data.lerobot_video import read_images
from manip.data.stored_episode import (
    MOST_JSON,
    Recording,
    StoredEpisode,
    read_recording,
)
from manip.errors import DamagedError, UserError, one_line

Array = np.ndarray


def read_lerobot(folder: Path) -> tuple[Recording, list[StoredEpisode]]:
    """Read the episodes; their last row has become the observation after the last step.

    Raises:
        DamagedError: it is no such data set, or one of another origin.
    """
    try:
        return _read(folder)
    except UserError as error:
        raise DamagedError(f"{folder}: {error}") from error
    except Exception as error:  # a file can hold anything
        raise DamagedError(f"{folder} is damaged: {one_line(error)}") from error


def _read(folder: Path) -> tuple[Recording, list[StoredEpisode]]:
    path = folder / layout.INFO
    if path.stat().st_size > MOST_JSON:
        raise UserError(f"{layout.INFO} is larger than {MOST_JSON} bytes")
    info = json.loads(path.read_text(encoding="utf-8"))
    if not isinstance(info, dict) or info.get("codebase_version") != layout.VERSION:
        raise UserError(f"it is no LeRobot data set {layout.VERSION}")
    if "manip" not in info:
        raise UserError(
            "another program recorded it: its observations are not those of a task "
            "here; use a robomimic file with states"
        )
    recording = read_recording(info["manip"])
    files = sorted((folder / "data").glob("chunk-*/file-*.parquet"))
    columns = _columns(files, _widths(recording))
    lengths = _lengths(columns["episode_index"])
    starts = np.cumsum([0, *lengths])
    places = _video_places(folder, recording)
    return recording, [
        _episode(folder, recording, columns, slice(*starts[i : i + 2]), places, i)
        for i in range(len(lengths))
    ]


def _widths(recording: Recording) -> dict[str, int | None]:
    """Column -> its width; None for that of the action, which is not known."""
    sizes = {p.name: int(np.prod(p.shape)) for p in recording.spec.parts}
    widths: dict[str, int | None] = {
        key: sum(sizes[name] for name in names)
        for key, names in layout.vector_parts(recording).items()
    }
    labels = (layout.LABEL,) if recording.noise else ()
    widths |= dict.fromkeys(("action", *labels), None)
    return widths | dict.fromkeys((layout.REWARD, layout.SUCCESS, "episode_index"), 1)


def _columns(files: list[Path], widths: dict[str, int | None]) -> dict[str, Array]:
    """Column -> [S, k] of all files.

    Raises:
        UserError: they are too large, or a column has another width.
    """
    parquet = library("pyarrow.parquet")
    tables: list[Any] = []
    left = MOST_BYTES
    for path in files:
        meta = parquet.read_metadata(path)
        left -= sum(
            meta.row_group(i).total_byte_size for i in range(meta.num_row_groups)
        )
        if left < 0:
            raise UserError(f"its rows are larger than {MOST_BYTES} bytes")
        tables.append(parquet.read_table(path, columns=[*widths]))
    if not tables:
        raise UserError("it has no files data/chunk-*/file-*.parquet")
    return {
        name: np.concatenate([_numbers(t.column(name), width) for t in tables])
        for name, width in widths.items()
    }


def _numbers(column: Any, width: int | None) -> Array:
    """A column [S, k] of numbers, or lists of one length."""
    whole, rows = column.combine_chunks(), len(column)
    flat = (
        whole.flatten()
        if hasattr(whole, "flatten") and whole.type.num_fields
        else whole
    )
    values = np.asarray(flat.to_numpy(zero_copy_only=False))
    if values.dtype.kind not in "biuf" or not rows or values.size % rows:
        raise UserError("a column holds no numbers, or lists of several lengths")
    if width is not None and values.size != rows * width:
        raise UserError(f"a column has {values.size // rows} numbers, not {width}")
    return values.reshape(rows, -1)


def _lengths(episode: Array) -> list[int]:
    """Rows of each episode, which are numbered from 0 in order."""
    numbers, counts = np.unique(episode, return_counts=True)
    ordered = (np.diff(episode[:, 0]) >= 0).all() and (
        numbers == np.arange(len(numbers))
    ).all()
    if not ordered or len(numbers) > MOST_EPISODES or counts.min() < 2:
        raise UserError("its episodes are not in order, or shorter than two rows")
    return counts.tolist()


def _video_places(folder: Path, recording: Recording) -> list[dict[str, Any]]:
    """For each episode where its images lie; nothing without cameras."""
    if not recording.cameras:
        return []
    names = [
        f"videos/{image_key(camera)}/{entry}"
        for camera in recording.cameras
        for entry in ("chunk_index", "file_index", "from_timestamp")
    ]
    path = folder / layout.EPISODES
    places: list[dict[str, Any]] = (
        library("pyarrow.parquet").read_table(path, columns=names).to_pylist()
    )
    return places


def _episode(
    folder: Path,
    recording: Recording,
    columns: dict[str, Array],
    rows: slice,
    places: list[dict[str, Any]],
    index: int,
) -> StoredEpisode:
    own = {name: values[rows] for name, values in columns.items()}
    parts: dict[str, Array] = {}
    for key, names in layout.vector_parts(recording).items():
        spec = recording.spec.select(names)
        parts |= spec.split(own[key])
    action = own["action"][:-1].astype(np.float32)
    label = own.get(layout.LABEL, own["action"])[:-1].astype(np.float32)
    images = {
        camera: _images(folder, recording, camera, places[index], len(own["action"]))
        for camera in recording.cameras
    }
    return StoredEpisode(
        observation=recording.spec.join(parts),
        action=action,
        label=label,
        reward=own[layout.REWARD][:-1, 0].astype(np.float32),
        success=own[layout.SUCCESS][:-1, 0].astype(bool),
        images=images,
    )


def _images(
    folder: Path, recording: Recording, camera: str, place: dict[str, Any], count: int
) -> Array:
    """[T + 1, H, W, 3]: the images of a camera in an episode, the bottom row first."""
    key = f"videos/{image_key(camera)}"
    file = int(place[f"{key}/chunk_index"]) * layout.CHUNK
    file += int(place[f"{key}/file_index"])
    path = folder / file_path(layout.VIDEO, file, key=image_key(camera))
    first = round(float(place[f"{key}/from_timestamp"]) * recording.control_freq)
    (shape,) = (part.shape for part in recording.spec.parts if part.name == camera)
    return read_images(path, first, count, shape)[:, ::-1].copy()
