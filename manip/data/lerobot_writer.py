"""Write a LeRobotDataset v3 with pyarrow and av, without lerobot itself.

One row for each control step, and for each camera a video of all episodes, upright.
Features: observation.state (parts of role proprioception, joined),
observation.environment_state (the other parts), observation.images.<camera>, action,
next.reward, next.success, next.done, and LeRobot's indices.
"""

import json
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from manip.data import lerobot_layout as layout
from manip.data.extra_libraries import library
from manip.data.feature_stats import FeatureStats
from manip.data.lerobot_layout import file_path, image_key
from manip.data.lerobot_video import VideoFiles
from manip.data.stored_episode import Recording, StoredEpisode
from manip.io.atomic_files import replace_file, write_text

Array = np.ndarray


def write_lerobot(
    folder: Path, recording: Recording, episodes: Iterator[StoredEpisode]
) -> Path:
    """Write the episodes into a folder; meta/info.json, which completes it, is last."""
    writer = LeRobotWriter(folder, recording)
    for episode in episodes:
        writer.add(episode)
    writer.close()
    return folder


class LeRobotWriter:
    """Write episodes, one after the other, into a folder that is new or empty."""

    def __init__(self, folder: Path, recording: Recording) -> None:
        self._folder, self._recording = folder, recording
        self._arrow = library("pyarrow")
        self._parquet = library("pyarrow.parquet")
        self._stats: dict[str, FeatureStats] = defaultdict(FeatureStats)
        self._rows: list[dict[str, Array]] = []
        self._episodes: list[dict[str, Any]] = []
        self._videos = {
            name: VideoFiles(folder, image_key(name), recording.control_freq)
            for name in recording.cameras
        }
        self._frames = self._file = self._bytes = self._width = 0

    def add(self, episode: StoredEpisode) -> None:
        """Append an episode; its rows reach the disk once a file is full."""
        self._width = episode.action.shape[1]
        columns = self._columns(episode)
        row = self._place(episode.steps) | self._add_stats(columns)
        for name, files in self._videos.items():
            upright = episode.images[name][:-1, ::-1]
            row |= files.add(upright) | self._add_stats({image_key(name): upright})
        self._episodes.append(row)
        self._frames += episode.steps
        self._rows.append(columns)
        self._bytes += sum(values.nbytes for values in columns.values())
        if self._bytes >= layout.SIZES["data_files_size_in_mb"] << 20:
            self._write_rows()

    def close(self) -> None:
        """Write what is left, and the description of the data set."""
        if self._rows:
            self._write_rows()
        for files in self._videos.values():
            files.close()
        table = self._arrow.Table.from_pylist(self._episodes)
        self._write_table(layout.EPISODES, table)
        self._write_table(layout.TASKS, self._tasks())
        stats = {key: stat.values() for key, stat in self._stats.items()}
        self._write_json(layout.STATS, stats)
        self._write_json(layout.INFO, self._info())

    def _place(self, steps: int) -> dict[str, Any]:
        """Where the next episode lies."""
        return {
            "episode_index": len(self._episodes),
            "tasks": [self._recording.task],
            "length": steps,
            "data/chunk_index": self._file // layout.CHUNK,
            "data/file_index": self._file % layout.CHUNK,
            "dataset_from_index": self._frames,
            "dataset_to_index": self._frames + steps,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
        }

    def _add_stats(self, columns: dict[str, Array]) -> dict[str, Any]:
        """Add an episode to the statistics; return its own, as columns."""
        row: dict[str, Any] = {}
        for key, values in columns.items():
            own = FeatureStats()
            for stats in (own, self._stats[key]):
                (stats.add_images if values.ndim == 4 else stats.add)(values)
            named = own.values().items()
            row |= {f"stats/{key}/{name}": value for name, value in named}
        return row

    def _columns(self, episode: StoredEpisode) -> dict[str, Array]:
        """Feature -> [T] or [T, k], all but the images."""
        parts = self._recording.spec.split(episode.observation[:-1])
        joined = {
            key: np.concatenate([parts[n].reshape(episode.steps, -1) for n in names], 1)
            for key, names in layout.vector_parts(self._recording).items()
        }
        label = {layout.LABEL: episode.label} if self._recording.noise else {}
        frames = np.arange(episode.steps)
        return {
            **joined,
            "action": episode.action,
            **label,
            layout.REWARD: episode.reward,
            layout.SUCCESS: episode.success,
            layout.DONE: frames == episode.steps - 1,
            "timestamp": (frames / self._recording.control_freq).astype(np.float32),
            "frame_index": frames,
            "episode_index": np.full(episode.steps, len(self._episodes)),
            "index": self._frames + frames,
            "task_index": np.zeros(episode.steps, np.int64),
        }

    def _write_rows(self) -> None:
        """Write the rows since the last file into a new one."""
        names = self._rows[0]
        whole = {key: np.concatenate([row[key] for row in self._rows]) for key in names}
        table = self._arrow.table({k: self._column(v) for k, v in whole.items()})
        self._write_table(file_path(layout.DATA, self._file), table)
        self._rows, self._bytes = [], 0
        self._file += 1

    def _column(self, values: Array) -> Any:
        """A column of numbers, or of lists of one length."""
        flat = self._arrow.array(values.reshape(-1))
        if values.size == len(values):
            return flat
        return self._arrow.FixedSizeListArray.from_arrays(flat, values.shape[1])

    def _tasks(self) -> Any:
        """One row: the number of the task; its text is the index of a pandas table."""
        index = "__index_level_0__"
        columns = [
            {"name": name, "field_name": field, "pandas_type": kind}
            | {"numpy_type": numpy_type, "metadata": None}
            for name, field, kind, numpy_type in (
                ("task_index", "task_index", "int64", "int64"),
                (None, index, "unicode", "object"),
            )
        ]
        pandas = {"index_columns": [index], "column_indexes": [], "columns": columns}
        table = self._arrow.table({"task_index": [0], index: [self._recording.task]})
        return table.replace_schema_metadata({"pandas": json.dumps(pandas)})

    def _info(self) -> dict[str, Any]:
        episodes = len(self._episodes)
        features = layout.features_of(self._recording, self._width)
        for name, files in self._videos.items():
            features[image_key(name)]["info"] = files.info
        return {
            "codebase_version": layout.VERSION,
            "robot_type": self._recording.robot,
            "total_episodes": episodes,
            "total_frames": self._frames,
            "total_tasks": 1,
            "chunks_size": layout.CHUNK,
            **layout.SIZES,
            "fps": self._recording.control_freq,
            "splits": {"train": f"0:{episodes}"},
            "data_path": _template(layout.DATA),
            "video_path": _template(layout.VIDEO) if self._videos else None,
            "features": features,
            "manip": self._recording.to_json(),
        }

    def _write_table(self, name: str, table: Any) -> None:
        write = self._parquet.write_table
        replace_file(self._folder / name, lambda temporary: write(table, temporary))

    def _write_json(self, name: str, values: Any) -> None:
        write_text(self._folder / name, json.dumps(values, indent=4))


def _template(path: str) -> str:
    """A path with the names that LeRobot fills in."""
    for own, other in (("chunk", "chunk_index"), ("file", "file_index")):
        path = path.replace(f"{{{own}:", f"{{{other}:")
    return path.replace("{key}", "{video_key}")
