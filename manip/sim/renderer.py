"""Draw recorded states, with captions.

States are drawn afterwards, so that no simulation holds an OpenGL context.
"""

from collections.abc import Generator, Iterable, Sequence
from contextlib import closing
from copy import copy
from typing import NamedTuple

import mujoco
import numpy as np

from manip.errors import unknown
from manip.io.video import Caption, draw_caption
from manip.sim.drawer import Drawer
from manip.sim.gl import use_backend
from manip.sim.trail import Trail

WORKSPACE, CLOSEUP = "workspace", "closeup"
"""Additional cameras, from the arm's left: the whole arm and the table top; or the
space in which the hand works, in which small motions are better seen.
"""


class OwnView(NamedTuple):
    """A camera: the point that it looks at and its distance from it [m]; azimuth, 0
    where it looks along +x, and elevation, negative where it looks down [degree].
    """

    x: float
    y: float
    z: float
    distance: float
    azimuth: float = 225.0
    elevation: float = -18.0


_LOOK_AT = {
    WORKSPACE: OwnView(-0.16, 0.0, 1.08, distance=1.45),
    CLOSEUP: OwnView(0.0, 0.0, 0.99, distance=0.95),
}
"""Cameras for robosuite's table at (0, 0, 0.8) m and a base at x = -0.56 m."""

VISUAL_GROUP = 1
"""Group of the geoms that are drawn; robosuite: 0 collision, 1 visual, 2 mouse."""


def own_view(camera: str) -> OwnView:
    """The view of an additional camera."""
    return _LOOK_AT[camera]


def camera_names(model: mujoco.MjModel) -> tuple[str, ...]:
    """Names of the cameras for `render_frames`: additional ones, then the model's."""
    return *_LOOK_AT, *(model.camera(index).name for index in range(model.ncam))


def hide_decorations(model: mujoco.MjModel) -> None:
    """Hide the model's sites, in place, except those with "goal" in the name.

    robosuite marks a hidden site by a negative alpha: a goal gets a positive one.
    """
    for index in range(model.nsite):
        shown = "goal" in model.site(index).name
        model.site_rgba[index, 3] = abs(model.site_rgba[index, 3]) if shown else 0


def render_frames(
    model: mujoco.MjModel,
    states: Iterable[np.ndarray],
    camera: str | OwnView = WORKSPACE,
    width: int = 640,
    height: int = 480,
    captions: Sequence[Caption] | None = None,
    trail: str | None = None,
) -> Generator[np.ndarray, None, None]:
    """Draw T states [nq] as T frames, uint8 [height, width, 3], RGB.

    The model is robosuite's full one; it is copied when this is called. Where episodes
    set fields of the model, draw each episode with its own model.

    Args:
        model: the model.
        states: qpos [nq] of each frame.
        camera: one of `camera_names(model)`, or a view of one's own.
        width, height: of a frame [pixels].
        captions: one for each state.
        trail: name of a site; each frame shows its places in the frames before.

    Raises:
        UserError: the camera does not exist, or no OpenGL backend works here.
    """
    view = _view(model, camera)
    use_backend()
    path = None if trail is None else Trail(trail, view)
    frames = _draw(_drawable(model, width, height), states, view, (height, width), path)
    if captions is None:
        return frames
    pairs = zip(frames, captions, strict=True)
    return (draw_caption(frame, caption) for frame, caption in pairs)


def _view(model: mujoco.MjModel, camera: str | OwnView) -> mujoco.MjvCamera:
    if isinstance(camera, OwnView):
        return _free_view(camera)
    if camera in _LOOK_AT:
        return _free_view(_LOOK_AT[camera])
    if camera not in camera_names(model):
        raise unknown("camera", camera, camera_names(model))
    view = mujoco.MjvCamera()
    view.type = mujoco.mjtCamera.mjCAMERA_FIXED
    view.fixedcamid = model.camera(camera).id
    return view


def _free_view(own: OwnView) -> mujoco.MjvCamera:
    view = mujoco.MjvCamera()
    view.lookat[:] = own.x, own.y, own.z
    view.distance, view.azimuth, view.elevation = own[3:]
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
    size: tuple[int, int],
    trail: Trail | None,
) -> Generator[np.ndarray, None, None]:
    data = mujoco.MjData(model)
    options = _visual_only()
    with closing(Drawer(model, *size)) as drawer:
        for state in states:
            _pose(model, data, state)
            frame = drawer.draw(data, view, options)
            yield frame if trail is None else trail.draw(model, data, frame)


def _visual_only() -> mujoco.MjvOption:
    options = mujoco.MjvOption()
    options.geomgroup[:] = 0
    options.geomgroup[VISUAL_GROUP] = 1
    return options


def _pose(model: mujoco.MjModel, data: mujoco.MjData, qpos: np.ndarray) -> None:
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    mujoco.mj_camlight(model, data)
