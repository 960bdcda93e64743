"""Draw captions over frames, and write animation files."""

from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass
from functools import cache
from itertools import chain
from pathlib import Path

import imageio_ffmpeg
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from manip.errors import UserError, unknown
from manip.io.atomic_files import replace_file

_GREEN = (34, 139, 60)
_GREY = (45, 45, 45)
_GIF_COLOURS = 128


@dataclass(frozen=True)
class Caption:
    """Text over a frame, one or more short lines; a green border marks a success."""

    text: str
    success: bool = False


def draw_caption(frame: np.ndarray, caption: Caption) -> np.ndarray:
    """Return a copy of the frame, uint8 [H, W, 3], with the caption drawn over it."""
    image = Image.fromarray(frame)
    canvas = ImageDraw.Draw(image)
    size = max(10, image.height // 22)
    if caption.success:
        _draw_border(canvas, image.size, size // 4)
    _draw_badge(canvas, caption, size)
    return np.asarray(image)


def save_animation(path: Path, frames: Iterable[np.ndarray], fps: float) -> None:
    """Write frames, uint8 [H, W, 3], to an .mp4 or .gif file.

    The file appears when it is complete. Frames are read one by one, none before
    the suffix is checked.

    Args:
        path: the file.
        frames: the frames, all of one size.
        fps: frames per second.

    Raises:
        UserError: the suffix is not supported, or there are no frames.
    """
    if path.suffix not in _WRITERS:
        raise unknown("animation format", path.suffix, _WRITERS)
    remaining = iter(frames)
    first = next(remaining, None)
    if first is None:
        raise UserError(f"no frames to write to {path}")
    write = _WRITERS[path.suffix]
    replace_file(path, lambda partial: write(partial, first, remaining, fps))


def _draw_border(canvas: ImageDraw.ImageDraw, size: tuple[int, int], line: int) -> None:
    width, height = size
    canvas.rectangle((0, 0, width - 1, height - 1), outline=_GREEN, width=line)


def _draw_badge(canvas: ImageDraw.ImageDraw, caption: Caption, size: int) -> None:
    corner = (size, size)
    left, top, right, bottom = canvas.textbbox(corner, caption.text, _font(size))
    pad = size // 3
    box = (left - pad, top - pad, right + pad, bottom + pad)
    canvas.rounded_rectangle(box, pad, _GREEN if caption.success else _GREY)
    canvas.text(corner, caption.text, "white", _font(size))


@cache
def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size)


def _write_mp4(
    path: Path, first: np.ndarray, rest: Iterator[np.ndarray], fps: float
) -> None:
    """Encode H.264 that browsers play while loading; odd sizes become even."""
    height, width, _ = first.shape
    encoder = imageio_ffmpeg.write_frames(
        str(path),
        (width, height),
        fps=fps,
        codec="libx264",
        pix_fmt_out="yuv420p",
        macro_block_size=2,
        output_params=["-movflags", "+faststart"],
    )
    with closing(encoder):
        encoder.send(None)
        for frame in chain([first], rest):
            encoder.send(np.ascontiguousarray(frame))


def _write_gif(
    path: Path, first: np.ndarray, rest: Iterator[np.ndarray], fps: float
) -> None:
    images = (_few_colours(frame) for frame in rest)
    _few_colours(first).save(
        path, save_all=True, append_images=images, duration=1000 / fps, loop=0
    )


def _few_colours(frame: np.ndarray) -> Image.Image:
    """Reduce the colours by octree; a median cut would lose small bright objects."""
    return Image.fromarray(frame).quantize(_GIF_COLOURS, Image.Quantize.FASTOCTREE)


_WRITERS = {".mp4": _write_mp4, ".gif": _write_gif}
