"""Draw a model in the process's OpenGL thread."""

import mujoco
import numpy as np

from manip.errors import UserError
from manip.sim.canvas import Canvas
from manip.sim.gl_thread import InGLThread


class Drawer:
    """Draw a model; every OpenGL call is made in the process's OpenGL thread.

    Args:
        model: its offscreen buffer is at least as large as the image.
        height, width: of the image [pixels].
    """

    def __init__(self, model: mujoco.MjModel, height: int, width: int) -> None:
        self._shape = height, width, 3
        self._canvas: InGLThread[Canvas] | None
        self._canvas = InGLThread(lambda: Canvas(model, height, width))
        # robosuite's floor reflects 1 %: invisible, yet a quarter of the drawing time
        self._canvas.opened.reflect(False)

    def draw(
        self, data: mujoco.MjData, view: mujoco.MjvCamera, options: mujoco.MjvOption
    ) -> np.ndarray:
        """Draw a state; returns uint8 [height, width, 3], RGB, top row first."""
        canvas = self._canvas
        if canvas is None:
            raise UserError("this renderer is closed: start another one")
        image = np.empty(self._shape, np.uint8)
        canvas.call(lambda: canvas.opened.draw(data, view, options, image))
        return np.flipud(image).copy()

    def close(self) -> None:
        """Free the OpenGL context; does nothing the second time."""
        canvas, self._canvas = self._canvas, None
        if canvas is not None:
            canvas.close()
