"""Clips: short pieces of behaviour that people and simulated labellers compare.

A clip can be drawn, repeated and measured again: it holds the complete state of the
batch engine at its start, and its actions. Files are safetensors with a checksum; a
clip's id is a hash of its contents, and the name of its file.
"""

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from manip.errors import DamagedError, UserError, one_line, shown
from manip.io.tensor_trees import load_tree, save_tree
from manip.preferences.clip_header import ClipHeader, read_header

Array = np.ndarray

FOLDER = "clips"
"""Folder of the clips in a folder of preferences."""

ID = re.compile(r"[0-9a-f]{24}")
"""A clip's id: the first 96 bits of a SHA-256."""

MOST_BYTES = 2**24
"""Largest clip file that is read."""

MOST_STEPS = 1000
"""Longest clip [control steps]."""

_DIMS = {
    "states": ("S",),
    "readings": ("R",),
    "motion": (3, 3),
    "qpos": ("T+1", "nq"),
    "observation": ("T", "D"),
    "action": ("T", "A"),
    "measures": ("T", "M"),
    "reward_terms": ("T", "K"),
}
"""Array -> its shape."""
_DTYPES = dict.fromkeys(("states", "readings", "motion", "qpos"), np.float64)
"""Arrays that are not float32."""


@dataclass(frozen=True)
class Clip:
    """T control steps of one environment.

    Attributes:
        header: where the clip comes from.
        states, readings: [S], [R] float64, the environment's rows in the batch engine
            at the clip's start.
        motion: [3, 3] float64, the motion of the hand then (see `HandMotion.rows`).
        qpos: [T + 1, nq] float64, the joints before each step and after the last.
        observation: [T, D] float32, before each step.
        action: [T, A] float32.
        measures: [T, M] float32, after each step, named as header.measure_names.
        reward_terms: [T, K] float32, after each step, named as header.reward_names.
    """

    header: ClipHeader
    states: Array
    readings: Array
    motion: Array
    qpos: Array
    observation: Array
    action: Array
    measures: Array
    reward_terms: Array

    @property
    def steps(self) -> int:
        """T."""
        return len(self.action)

    @property
    def widths(self) -> tuple[int, int]:
        """D and A."""
        return self.observation.shape[1], self.action.shape[1]

    @property
    def reward(self) -> Array:
        """[T] float64, the task's reward of each step."""
        weights = np.array(list(self.header.reward_weights.values()))
        return self.reward_terms.astype(np.float64) @ weights

    def measure(self, name: str) -> Array:
        """[T] float32, one of the visible measures.

        Raises:
            ValueError: the clip has no such measure.
        """
        return self.measures[:, self.header.measure_names.index(name)]

    @cached_property
    def id(self) -> str:
        """The first 24 hexadecimal digits of the SHA-256 of all contents."""
        digest = hashlib.sha256(json.dumps(asdict(self.header)).encode())
        for name, array in self.arrays().items():
            digest.update(f"{name}{array.dtype}{array.shape}".encode())
            digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()[:24]

    def arrays(self) -> dict[str, Array]:
        """Name -> array."""
        return {name: getattr(self, name) for name in _DIMS}


def save_clip(folder: Path, clip: Clip) -> str:
    """Write a clip into the folder `clips` of a folder of preferences, atomically.

    Returns:
        The clip's id.

    Raises:
        UserError: an array has a wrong shape or dtype, or is not finite.
    """
    _check(clip)
    path = clip_path(folder, clip.id)
    if not path.exists():
        save_tree(path, {"header": _plain(clip.header), **clip.arrays()})
    return clip.id


def load_clip(folder: Path, clip_id: str) -> Clip:
    """Read a clip of a folder of preferences.

    Raises:
        UserError: there is no such clip.
        DamagedError: its file was changed, or is of another kind.
    """
    path = clip_path(folder, clip_id)
    if path.is_file() and path.stat().st_size > MOST_BYTES:
        raise DamagedError(f"{path} is no clip: it is larger than {MOST_BYTES} bytes")
    tree = load_tree(path)
    try:
        clip = _clip(tree)
    except (UserError, KeyError, TypeError) as error:
        raise DamagedError(f"{path} is no clip: {one_line(error)}") from error
    if clip.id != clip_id:
        raise DamagedError(f"{path} is no clip: its contents have the id {clip.id}")
    return clip


def clip_ids(folder: Path) -> list[str]:
    """Ids of the clips in a folder of preferences, in alphabetical order."""
    paths = (folder / FOLDER).glob("*.safetensors")
    return sorted(path.stem for path in paths if ID.fullmatch(path.stem))


def clip_path(folder: Path, clip_id: str) -> Path:
    """The file of a clip.

    Raises:
        UserError: the id is not 24 hexadecimal digits.
    """
    return folder / FOLDER / f"{check_clip_id(clip_id)}.safetensors"


def check_clip_id(clip_id: object) -> str:
    """The id, if it is one; anything else could be a path that leaves the folder.

    Raises:
        UserError: it is not 24 hexadecimal digits.
    """
    if not isinstance(clip_id, str) or not ID.fullmatch(clip_id):
        raise UserError(
            f"{shown(clip_id)} is no id of a clip: it must be 24 digits 0-9, a-f"
        )
    return clip_id


def _plain(header: ClipHeader) -> dict[str, Any]:
    return asdict(header) | {"measure_names": list(header.measure_names)}


def _clip(tree: Any) -> Clip:
    if not isinstance(tree, Mapping):
        raise UserError("it holds no clip")
    names = {field.name for field in fields(Clip)}
    if tree.keys() != names:
        raise UserError(f"it holds {shown(sorted(tree))}, not {sorted(names)}")
    clip = Clip(**{**tree, "header": read_header(tree["header"])})
    _check(clip)
    return clip


def _check(clip: Clip) -> None:
    """Raise `UserError` unless every array has its shape and dtype, and is finite."""
    for name, array in clip.arrays().items():
        dtype = np.dtype(_DTYPES.get(name, np.float32))
        if not isinstance(array, np.ndarray) or array.dtype != dtype:
            raise UserError(f"{name} is no array of {dtype}")
        if array.ndim != len(_DIMS[name]):
            raise UserError(f"{name} has shape {array.shape}, not {_DIMS[name]}")
        if not np.isfinite(array).all():
            raise UserError(f"{name} holds numbers that are not finite")
    steps, header = clip.steps, clip.header
    if not 1 <= steps <= MOST_STEPS:
        raise UserError(f"a clip has 1 to {MOST_STEPS} steps, not {steps}")
    expected = {
        "motion": (3, 3),
        "qpos": (steps + 1, clip.qpos.shape[1]),
        "observation": (steps, clip.observation.shape[1]),
        "measures": (steps, len(header.measure_names)),
        "reward_terms": (steps, len(header.reward_weights)),
    }
    for name, shape in expected.items():
        if getattr(clip, name).shape != shape:
            given = getattr(clip, name).shape
            raise UserError(f"{name} has shape {given}, expected {shape}")
