"""An OpenGL context, and MuJoCo's memory to draw one model in it."""

import importlib

import mujoco
import numpy as np

from manip.errors import UserError
from manip.sim.names import lookup

Array = np.ndarray

MAX_GEOMS = 10_000
"""Most geoms in an image, as in robosuite (utils/binding_utils.py)."""

BINDING = "mujoco.rendering.classic.gl_context"
"""Module of mujoco's OpenGL contexts, of the backend in MUJOCO_GL."""


class Canvas:
    """Draw images of one model and one size; in the OpenGL thread only.

    Args:
        model: what is drawn. Its meshes and textures are copied to OpenGL.
        height, width: of an image [pixels], at most those of its offscreen buffer.

    Raises:
        UserError: the image is larger than the model's offscreen buffer.
    """

    def __init__(self, model: mujoco.MjModel, height: int, width: int) -> None:
        screen = model.vis.global_
        if width > screen.offwidth or height > screen.offheight:
            raise UserError(
                f"an image of {width} x {height} pixels is larger than the model's "
                f"framebuffer, {screen.offwidth} x {screen.offheight}"
            )
        self._model = model
        self._area = mujoco.MjrRect(0, 0, width, height)
        self._context = importlib.import_module(BINDING).GLContext(width, height)
        self._context.make_current()
        scale = mujoco.mjtFontScale.mjFONTSCALE_150
        self._drawing = mujoco.MjrContext(model, scale.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._drawing)
        self._scene = mujoco.MjvScene(model, MAX_GEOMS)
        self._closed = False

    def reflect(self, reflections: bool) -> None:
        """Draw reflections or leave them out; they are drawn by default."""
        self._scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = reflections

    def set_textures(self, ids: Array) -> None:
        """Change which textures materials have: ids [materials, roles].

        The context holds its own copy of the model's `mat_texid`.
        """
        self._drawing.mat_texid[: ids.size] = ids.reshape(-1)

    def draw(
        self,
        data: mujoco.MjData,
        view: mujoco.MjvCamera,
        options: mujoco.MjvOption,
        image: Array,
    ) -> None:
        """Draw a state into `image`, uint8 [height, width, 3], bottom row first."""
        everything = mujoco.mjtCatBit.mjCAT_ALL
        self._context.make_current()
        mujoco.mjv_updateScene(
            self._model, data, options, None, view, everything, self._scene
        )
        mujoco.mjr_render(self._area, self._scene, self._drawing)
        mujoco.mjr_readPixels(image, None, self._area, self._drawing)

    def close(self) -> None:
        """Free the context and what it holds; does nothing the second time.

        MuJoCo deletes textures and lists by numbers, in the context that is current.
        """
        if not self._closed:
            self._closed = True
            self._context.make_current()
            self._drawing.free()
            self._context.free()


def camera_view(model: mujoco.MjModel, camera: str) -> mujoco.MjvCamera:
    """The view of one of the model's cameras.

    Raises:
        UserError: no such camera; the message lists the cameras that exist.
    """
    view = mujoco.MjvCamera()
    view.type = mujoco.mjtCamera.mjCAMERA_FIXED
    view.fixedcamid = lookup(model, "camera", camera)
    return view
