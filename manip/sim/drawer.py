"""mujoco's Renderer in a separate thread, closed before the process ends."""

import weakref
from collections.abc import Callable
from typing import TypeVar

import mujoco
import numpy as np

from manip.errors import UserError
from manip.sim.gl_thread import GLThread

Result = TypeVar("Result")

_thread: GLThread | None = None


class Drawer:
    """Draw a model; every OpenGL call is made in one `GLThread`.

    Args:
        model: its offscreen buffer is at least as large as the picture.
        height, width: of the picture [pixels].
    """

    def __init__(self, model: mujoco.MjModel, height: int, width: int) -> None:
        self._renderer: mujoco.Renderer | None
        self._renderer = _call(lambda: mujoco.Renderer(model, height, width))
        # robosuite's floor reflects 1 %: invisible, yet a quarter of the drawing time
        reflection = mujoco.mjtRndFlag.mjRND_REFLECTION
        self._renderer.scene.flags[reflection] = False
        _open.add(self)

    def draw(
        self, data: mujoco.MjData, view: mujoco.MjvCamera, options: mujoco.MjvOption
    ) -> np.ndarray:
        """Draw a state; returns uint8 [height, width, 3], RGB."""
        renderer = self._renderer
        if renderer is None:
            raise UserError("this renderer is closed: start another one")

        def work() -> np.ndarray:
            renderer.update_scene(data, view, options)
            frame: np.ndarray = renderer.render()
            return frame

        return _call(work)

    def close(self) -> None:
        """Free the OpenGL context; does nothing the second time."""
        renderer, self._renderer = self._renderer, None
        if renderer is not None:
            _call(renderer.close)


_open: weakref.WeakSet[Drawer] = weakref.WeakSet()


def _call(function: Callable[[], Result]) -> Result:
    global _thread
    if _thread is None or not _thread.alive:
        _thread = GLThread(at_end=_close_all)
    return _thread.call(function)


def _close_all() -> None:
    for drawer in list(_open):
        drawer.close()
