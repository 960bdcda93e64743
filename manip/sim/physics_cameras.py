"""PhysicsCameras: images of a MuJoCo simulation that another library steps."""

import mujoco
import numpy as np

from manip.cameras import CameraConfig, part_name
from manip.sim.canvas import Canvas, camera_view
from manip.sim.gl import use_backend
from manip.sim.gl_thread import InGLThread
from manip.sim.not_copied import NotCopied

Array = np.ndarray


class PhysicsCameras(NotCopied):
    """Draw the present state of a model's data, as dm_control's physics.render does.

    Args:
        cameras: the cameras, and the size of the images.

    Raises:
        UserError: no OpenGL backend works here.
    """

    def __init__(self, cameras: CameraConfig) -> None:
        self._cameras = cameras
        self._model: mujoco.MjModel | None = None
        self._canvas: InGLThread[Canvas] | None = None
        self._views: list[mujoco.MjvCamera] = []
        if cameras.names:
            use_backend()

    def draw(self, model: mujoco.MjModel, data: mujoco.MjData) -> dict[str, Array]:
        """Draw the positions in `data`: part name -> uint8 [H, W, 3], bottom row first.

        Raises:
            UserError: the model has no such camera.
        """
        size = self._cameras.size
        images = {
            part_name(name): np.empty((size, size, 3), np.uint8)
            for name in self._cameras.names
        }
        if images:
            canvas = self._opened(model)
            canvas.call(lambda: self._fill(canvas.opened, data, images))
        return images

    def _opened(self, model: mujoco.MjModel) -> InGLThread[Canvas]:
        """The canvas of the model; another one if the library compiled it again."""
        if self._canvas is None or model is not self._model:
            self._views = [camera_view(model, name) for name in self._cameras.names]
            self._model, size = model, self._cameras.size
            self._canvas = InGLThread(lambda: Canvas(model, size, size))
        return self._canvas

    def _fill(
        self, canvas: Canvas, data: mujoco.MjData, images: dict[str, Array]
    ) -> None:
        options = mujoco.MjvOption()
        for view, image in zip(self._views, images.values(), strict=True):
            canvas.draw(data, view, options, image)
