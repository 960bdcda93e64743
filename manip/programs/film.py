"""Draw recorded episodes: as a film, or as stills in one image."""

from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from manip.evaluation.episode_recording import RecordedEpisode
from manip.io.atomic_files import replace_file
from manip.io.video import Caption, save_animation
from manip.sim.renderer import OwnView, render_frames

Array = np.ndarray


@dataclass(frozen=True)
class Film:
    """How episodes are drawn.

    Attributes:
        cameras: shown side by side.
        width, height: of each camera's image [pixel].
        control_freq: states a second of the episodes [Hz].
        fps: frames a second of the film.
        speed: seconds of an episode in a second of the film.
        steps: states shown of an episode; None for all.
        images: show the images that the policy saw, too.
        titles: of the policies that are shown side by side, before the caption.
    """

    cameras: Sequence[str | OwnView]
    width: int
    height: int
    control_freq: int
    fps: float
    speed: float
    steps: int | None
    images: bool
    titles: Sequence[str]

    def places(self, episode: RecordedEpisode) -> Array:
        """[F]: the state of each frame, between two states where it is not whole."""
        stride = self.speed * self.control_freq / self.fps
        last = min(len(episode.poses), self.steps or len(episode.poses)) - 1
        return np.arange(0, last + 1e-9, stride)


Rows = Sequence[Sequence[RecordedEpisode]]
"""Episodes of each policy, in the same order."""


def save_film(path: Path, rows: Rows, film: Film) -> None:
    """Write an .mp4 or .gif file: episode after episode, the policies side by side."""
    frames = (
        frame
        for episodes in zip(*rows, strict=True)
        for frame in _side_by_side(
            [
                _frames(episode, film, title, film.places(episode))
                for episode, title in zip(episodes, film.titles, strict=True)
            ]
        )
    )
    save_animation(path, frames, film.fps)


def save_stills(path: Path, rows: Rows, film: Film, number: int) -> None:
    """Write a .png file: a row for each episode, `number` states from start to end."""
    lines = []
    for episodes in zip(*rows, strict=True):
        for episode, title in zip(episodes, film.titles, strict=True):
            last = film.places(episode)[-1]
            places = np.linspace(0, last, number) if number > 1 else np.array([last])
            frames = _frames(episode, film, title, np.round(places))
            lines.append(np.concatenate(list(frames), axis=1))
    image = Image.fromarray(np.concatenate(lines))
    replace_file(path, lambda partial: image.save(partial))


def first_image(episode: RecordedEpisode, film: Film) -> Array:
    """The first frame, which fails where camera, size or OpenGL do not work."""
    with closing(_frames(episode, film, film.titles[0], np.zeros(1))) as frames:
        return next(frames)


def _frames(
    episode: RecordedEpisode, film: Film, title: str, places: Array
) -> Generator[Array, None, None]:
    """Frames of an episode at some places: its cameras and images side by side."""
    poses = [_between(episode.poses, place) for place in places]
    captions = [_caption(episode, title, int(place)) for place in places]
    size = film.width, film.height
    with ExitStack() as stack:
        views = [
            stack.enter_context(
                closing(render_frames(episode.model(), poses, camera, *size, texts))
            )
            for camera, texts in _with_captions(film.cameras, captions)
        ]
        for place, panels in zip(places, zip(*views, strict=True), strict=True):
            frame = np.concatenate(panels, axis=1)
            images = episode.images[int(place)]
            yield beside(frame, images) if film.images else frame


def _with_captions(
    cameras: Sequence[str | OwnView], captions: list[Caption]
) -> Iterator[tuple[str | OwnView, list[Caption] | None]]:
    """Captions stand over the first camera only."""
    for index, camera in enumerate(cameras):
        yield camera, None if index else captions


def _between(poses: Array, place: float) -> Array:
    """The pose [nq] at a place between two of [T, nq], for slow motion."""
    start = int(place)
    end, share = min(start + 1, len(poses) - 1), place - start
    pose: Array = (1 - share) * poses[start] + share * poses[end]
    return pose


def _caption(episode: RecordedEpisode, title: str, step: int) -> Caption:
    success = bool(episode.success[step])
    text = f"{title}episode {episode.episode.index}   step {step}"
    return Caption(text + ("   SUCCESS" if success else ""), success)


def _side_by_side(streams: Sequence[Iterable[Array]]) -> Iterator[Array]:
    """Join frames of several streams; one that ends earlier shows its last frame."""
    iterators = [iter(stream) for stream in streams]
    latest: list[Array | None] = [None] * len(iterators)
    while True:
        new = [next(iterator, None) for iterator in iterators]
        if all(frame is None for frame in new):
            return
        latest = [n if n is not None else o for n, o in zip(new, latest, strict=True)]
        yield np.concatenate([frame for frame in latest if frame is not None], axis=1)


def beside(frame: Array, images: Sequence[Array]) -> Array:
    """Put images, one below the other, at the right of a frame.

    Args:
        frame: [H, W, 3] uint8.
        images: [S, S, 3 k] uint8 each, the bottom row first; the last 3 channels, the
            latest image, are shown.

    Returns:
        [H, W + H / number of images, 3] uint8; less than that many rows are black.
    """
    side = frame.shape[0] // len(images)
    column = np.zeros((frame.shape[0], side, 3), np.uint8)
    for number, image in enumerate(images):
        place = np.arange(side) * len(image) // side
        enlarged = image[::-1, :, -3:][place][:, place]
        column[number * side : (number + 1) * side] = enlarged
    return np.concatenate([frame, column], axis=1)
