"""Draw clips to video files ahead of time, in a background thread."""

import threading
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path

from manip.errors import DamagedError, UserError, one_line

IDLE = 1.0
"""Seconds between looks for clips to draw, when all are drawn."""


class ClipVideos:
    """The video of each clip, in a folder that may be deleted at any time.

    Args:
        folder: where the videos are stored.
        draw: draws a clip's video to a path, atomically.
        needed: the clips to draw, the most urgent one first.
    """

    def __init__(
        self,
        folder: Path,
        draw: Callable[[str, Path], None],
        needed: Callable[[], Iterable[str]],
    ) -> None:
        self._folder, self._draw, self._needed = folder, draw, needed
        self._failures: dict[str, str] = {}
        self._changed = threading.Condition()
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._work, name="manip-clips")

    def draw_first(self) -> None:
        """Draw the most urgent clip now, if there is one.

        Raises:
            UserError: nothing can be drawn here, or not from this camera.
        """
        clip = self._first_missing()
        if clip is not None:
            with suppress(DamagedError):  # the page says so when it shows the clip
                self._draw(clip, self._path(clip))

    def start(self) -> None:
        """Start to draw in the background."""
        self._thread.start()

    def close(self) -> None:
        """Stop after the clip that is being drawn."""
        self._closed.set()
        self._thread.join()

    def wait_for(self, clip: str, seconds: float) -> Path | None:
        """The video of a clip; None if it is not drawn within the time.

        Raises:
            UserError: the clip cannot be drawn.
        """
        path = self._path(clip)
        with self._changed:
            self._changed.wait_for(
                lambda: _is_drawn(path) or clip in self._failures, seconds
            )
        if clip in self._failures:
            raise UserError(f"clip {clip} cannot be drawn: {self._failures[clip]}")
        return path if _is_drawn(path) else None

    def _work(self) -> None:
        while not self._closed.is_set():
            clip = self._first_missing()
            if clip is None:
                self._closed.wait(IDLE)
            else:
                self._draw_one(clip)

    def _first_missing(self) -> str | None:
        with suppress(UserError, OSError):  # the page says what is wrong with files
            for clip in self._needed():
                if clip not in self._failures and not _is_drawn(self._path(clip)):
                    return clip
        return None

    def _draw_one(self, clip: str) -> None:
        try:
            self._draw(clip, self._path(clip))
        except Exception as error:  # shown to the labeller, who can go on
            self._failures[clip] = one_line(error)
        with self._changed:
            self._changed.notify_all()

    def _path(self, clip: str) -> Path:
        return self._folder / f"{clip}.mp4"


def _is_drawn(path: Path) -> bool:
    """Whether the video is there; a link, which may lead out of the folder, is not."""
    return path.is_file() and not path.is_symlink()
