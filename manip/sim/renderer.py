"""Pictures of recorded states: frames, captions, and animation files.

States are drawn after the fact, so nothing that simulates ever holds a GL context.
"""

from collections.abc import Generator, Iterable, Sequence
from copy import copy

import mujoco
import numpy as np

from manip.errors import unknown
from manip.io.video import Caption, draw_caption
from manip.sim.gl import use_backend

WORKSPACE = "workspace"
"""Camera added to the model's own: the whole arm and the table top, from its left."""

_VISUAL_GROUP = 1  # robosuite: 0 collision, 1 visual, 2 targets of the mouse


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
