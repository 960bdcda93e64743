"""Videos of a report's episodes, small enough to be part of its page."""

import base64
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from manip.evaluation.episode_recording import RecordedEpisode
from manip.io.video import save_animation
from manip.reports.recorded_episodes import RecordedEpisodes
from manip.reports.replays import chosen_episodes, outcome
from manip.sim.renderer import render_frames

WIDTH, HEIGHT = 480, 360
"""Size of the videos [pixels]."""


@dataclass(frozen=True)
class Film:
    """A video of an episode: H.264 in an .mp4 file."""

    number: int
    outcome: str
    video: bytes

    @property
    def data(self) -> str:
        """The file in base 64."""
        return base64.b64encode(self.video).decode()


def draw_films(record: RecordedEpisodes, count: int) -> list[Film]:
    """Draw at most `count` episodes, failures and successes, at their own speed.

    Raises:
        UserError: nothing can draw here.
    """
    recorder, rate = record.recorder, record.settings.robot.control_freq
    if recorder is None:
        return []
    return [
        Film(each.index, outcome(each), _video(recorder.recorded(each), rate))
        for each in chosen_episodes(record.episodes, count)
    ]


def _video(episode: RecordedEpisode, rate: int) -> bytes:
    model, poses = episode.model(), episode.poses
    frames = render_frames(model, poses, width=WIDTH, height=HEIGHT)
    with TemporaryDirectory(prefix="manip-") as folder, closing(frames):
        path = Path(folder) / "film.mp4"
        save_animation(path, frames, rate)
        return path.read_bytes()
