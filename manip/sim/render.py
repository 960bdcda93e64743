"""Pictures of recorded states: frames, captions, and animation files.

States are drawn after the fact, so nothing that simulates ever holds a GL context.
"""

from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import closing
from copy import copy
from dataclasses import dataclass
from functools import cache
from itertools import chain
from pathlib import Path

import imageio_ffmpeg
import mujoco
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from manip.errors import UserError, unknown
from manip.files import replace_file
from manip.sim.gl import use_backend

WORKSPACE = "workspace"
"""Camera added to the model's own: the whole arm and the table top, from its left."""

_VISUAL_GROUP = 1  # robosuite: 0 collision, 1 visual, 2 targets of the mouse
_GREEN = (34, 139, 60)
_GREY = (45, 45, 45)
_GIF_COLOURS = 128


@dataclass(frozen=True)
class Caption:
    """Text over a frame, one or more short lines; a success is framed in green."""

    text: str
    success: bool = False


def camera_names(model: mujoco.MjModel) -> tuple[str, ...]:
    """Return the cameras `render_frames` can draw from: workspace, then the model's."""
    return WORKSPACE, *(model.camera(index).name for index in range(model.ncam))


def hide_decorations(model: mujoco.MjModel) -> None:
    """Hide robosuite's markers in place: every site but those with "goal" in the name.

    robosuite hides a site by a negative alpha; a goal gets its positive alpha back.
    """
    for index in range(model.nsite):
        shown = "goal" in model.site(index).name
        model.site_rgba[index, 3] = abs(model.site_rgba[index, 3]) if shown else 0


def render_frames(
    model: mujoco.MjModel,
    states: Iterable[np.ndarray],
    camera: str = WORKSPACE,
    width: int = 640,
    height: int = 480,
    captions: Sequence[Caption] | None = None,
) -> Generator[np.ndarray, None, None]:
    """Draw T states [nq], giving T frames: uint8 [height, width, 3], in RGB.

    The model is robosuite's full one; it is copied as it is now and left unchanged.
    Where an episode moves bodies or sites of the model, draw each episode by itself.
    Captions, where given, are one a state.

    Raises:
        UserError: the camera does not exist, or no OpenGL backend works here.
    """
    view = _view(model, camera)
    use_backend()
    frames = _draw(_drawable(model, width, height), states, view, width, height)
    if captions is None:
        return frames
    pairs = zip(frames, captions, strict=True)
    return (draw_caption(frame, caption) for frame, caption in pairs)


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
    """Write frames, uint8 [H, W, 3], to an .mp4 or .gif file; it appears when complete.

    Frames are taken one at a time, and none is taken if the suffix is not supported.

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


def _view(model: mujoco.MjModel, camera: str) -> mujoco.MjvCamera:
    if camera == WORKSPACE:
        return _workspace_view()
    if camera not in camera_names(model):
        raise unknown("camera", camera, camera_names(model))
    view = mujoco.MjvCamera()
    view.type = mujoco.mjtCamera.mjCAMERA_FIXED
    view.fixedcamid = model.camera(camera).id
    return view


def _workspace_view() -> mujoco.MjvCamera:
    """Place a camera for a robosuite table at (0, 0, 0.8) m and a base at x = -0.56."""
    view = mujoco.MjvCamera()
    view.lookat[:] = (-0.16, 0.0, 1.08)
    view.distance, view.azimuth, view.elevation = 1.45, 225.0, -18.0
    return view


def _drawable(model: mujoco.MjModel, width: int, height: int) -> mujoco.MjModel:
    model = copy(model)
    hide_decorations(model)
    screen = model.vis.global_
    screen.offwidth = max(screen.offwidth, width)
    screen.offheight = max(screen.offheight, height)
    return model


def _draw(
    model: mujoco.MjModel,
    states: Iterable[np.ndarray],
    view: mujoco.MjvCamera,
    width: int,
    height: int,
) -> Generator[np.ndarray, None, None]:
    data = mujoco.MjData(model)
    options = _visual_only()
    with mujoco.Renderer(model, height, width) as renderer:
        _skip_reflections(renderer)
        for state in states:
            _pose(model, data, state)
            renderer.update_scene(data, view, options)
            yield renderer.render()


def _visual_only() -> mujoco.MjvOption:
    options = mujoco.MjvOption()
    options.geomgroup[:] = 0
    options.geomgroup[_VISUAL_GROUP] = 1
    return options


def _skip_reflections(renderer: mujoco.Renderer) -> None:
    """robosuite's floor reflects 1 %: unseen, yet a quarter of the drawing time."""
    renderer.scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False


def _pose(model: mujoco.MjModel, data: mujoco.MjData, qpos: np.ndarray) -> None:
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_camlight(model, data)


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
    """Encode H.264 that browsers play while it loads; odd sizes are scaled to even."""
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
    """Reduce the colours by octree: the median cut greys out small bright objects."""
    return Image.fromarray(frame).quantize(_GIF_COLOURS, Image.Quantize.FASTOCTREE)


_WRITERS = {".mp4": _write_mp4, ".gif": _write_gif}
