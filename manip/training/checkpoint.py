"""Checkpoint files of a run, and when they are written."""

import time
import warnings
from pathlib import Path
from types import TracebackType
from typing import Any

from manip.errors import DamagedError, UserError
from manip.io.atomic_files import link_file
from manip.io.tensor_trees import load_tree, save_tree

FORMAT = 7
"""Version of the checkpoint file; raised when it changes incompatibly."""

SAVING_SHARE = 0.05
"""Largest part of a run's time that checkpoints between evaluations may take."""


class Checkpoints:
    """The checkpoints of a run folder: the latest, the one before it, and the best.

    A checkpoint is written once and may have several names (hard links): a new best one
    is also the latest, and the latest later becomes the previous.
    """

    def __init__(self, run: Path) -> None:
        self.latest, self.previous, self.best = (
            run / "checkpoints" / f"{name}.safetensors"
            for name in ("latest", "previous", "best")
        )
        self._latest_is_whole = False

    def exist(self) -> bool:
        """Whether there is a checkpoint to resume from."""
        return any(path.is_file() for path in (self.latest, self.previous, self.best))

    def save(self, state: dict[str, Any], best: bool = False) -> None:
        """Write a state as the latest checkpoint, and also as the best one if it is."""
        if self._latest_is_whole:
            link_file(self.latest, self.previous)
        if best:  # first, as a run resumed from the latest would not find it better
            save_tree(self.best, state)
            link_file(self.best, self.latest)
        else:
            save_tree(self.latest, state)
        self._latest_is_whole = True

    def load(self) -> dict[str, Any]:
        """Read the newest undamaged state; warn of damaged newer ones.

        Raises:
            UserError: there is none, or another version wrote it.
        """
        damaged = None
        for path in (self.latest, self.previous, self.best):
            if path.is_file():
                try:
                    return self._checked(path, load_tree(path))
                except DamagedError as error:
                    damaged = damaged or error
                    warnings.warn(
                        f"{error}; trying the checkpoint before", stacklevel=2
                    )
        raise damaged or UserError(
            f"nothing to resume: there is no checkpoint in {self.latest.parent}"
        )

    def _checked(self, path: Path, state: Any) -> dict[str, Any]:
        version = state.get("format") if isinstance(state, dict) else None
        if version != FORMAT:
            raise UserError(
                f"{path} has format {version}, expected {FORMAT}: resume it with the "
                "version of manip that wrote it"
            )
        self._latest_is_whole = path == self.latest
        checked: dict[str, Any] = state
        return checked


class SaveTimer:
    """When the next checkpoint is due, and how long the last one took.

    Used as a context manager around the writing of a checkpoint.

    Args:
        every: seconds between checkpoints; more where writing takes long.

    Attributes:
        buffer_bytes: size of the replay buffer in the last checkpoint.
    """

    buffer_bytes = 0

    def __init__(self, every: float) -> None:
        self._every = every
        self._ended = time.monotonic()
        self._duration = 0.0

    def due(self) -> bool:
        """Whether it is time for the next checkpoint."""
        wait = max(self._every, self._duration / SAVING_SHARE)
        return time.monotonic() - self._ended > wait

    def describe(self, path: Path) -> str:
        """Size and time of the last checkpoint, in words."""
        size, buffer = path.stat().st_size / 2**20, self.buffer_bytes / 2**20
        part = f" (replay buffer: {buffer:,.1f} MiB; leave it out: --no-save-buffer)"
        whole = f"checkpoint: {size:,.1f} MiB{part if buffer > size / 10 else ''}"
        return f"{whole}, written in {self._duration:.1f} s"

    def __enter__(self) -> None:
        self._began = time.monotonic()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._ended = time.monotonic()
        self._duration = self._ended - self._began


def bytes_of(buffer: Any) -> int:
    """Bytes of a tensor, or of all tensors in a dict; 0 for None."""
    tensors = buffer.values() if isinstance(buffer, dict) else [buffer]
    return sum(tensor.nbytes for tensor in tensors if tensor is not None)
