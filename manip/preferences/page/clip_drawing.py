"""ClipDrawing: draw the clips of a folder of preferences as videos."""

from pathlib import Path

from manip.errors import UserError
from manip.io.video import save_animation
from manip.preferences.clip_player import ClipPlayer
from manip.preferences.clips import load_clip

WIDTH, HEIGHT = 640, 480
"""Size of the videos [pixels]."""

VIDEOS = "videos"
"""Folder of the videos in a folder of preferences. It may be deleted."""


class ClipDrawing:
    """Draw clips from one camera.

    Args:
        folder: the folder of preferences.
        camera: one of `manip.sim.renderer.camera_names` of the clips' scenes.
    """

    def __init__(self, folder: Path, camera: str) -> None:
        self._folder, self._camera = folder, camera
        self._player = ClipPlayer(folder)

    @property
    def videos(self) -> Path:
        """The folder of the videos from this camera."""
        return self._folder / VIDEOS / self._camera

    def draw(self, clip_id: str, path: Path) -> None:
        """Draw a clip at the speed at which it was acted, as H.264.

        Raises:
            UserError: there is no such clip or camera, nothing can draw here, or the
                folder of the videos is a link.
        """
        for place in (self.videos, self.videos.parent):
            if place.is_symlink():
                raise UserError(f"{place} is a link, and could lead out of the folder")
        if path.is_symlink():  # it would be followed
            path.unlink()
        clip = load_clip(self._folder, clip_id)
        frames = self._player.frames(clip, self._camera, WIDTH, HEIGHT)
        save_animation(path, frames, clip.header.control_freq)
