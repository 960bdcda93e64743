"""SceneCameras: images of a scene's states, drawn by several threads."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from manip.cameras import CameraConfig
from manip.looks import Looks
from manip.sim.canvas import camera_view
from manip.sim.gl import use_backend
from manip.sim.gl_thread import InGLThread
from manip.sim.not_copied import NotCopied
from manip.sim.scene import Scene
from manip.sim.scene_canvas import SceneCanvas

Array = np.ndarray

SAME = Looks()
"""Every episode looks as robosuite's."""


class SceneCameras(NotCopied):
    """Draw states of a scene; the OpenGL contexts stay open between calls.

    A deep copy is the object itself: it holds no state of an environment.

    Args:
        scene: what is drawn.
        cameras: the cameras, and the size of the images.
        looks: what varies between episodes.
        threads: threads that draw at the same time, each with an OpenGL context
            (0.2 GB); the images do not depend on their number.

    Raises:
        UserError: a camera does not exist, or no OpenGL backend works here.
    """

    def __init__(
        self,
        scene: Scene,
        cameras: CameraConfig,
        looks: Looks = SAME,
        threads: int = 1,
    ) -> None:
        for name in cameras.names:
            camera_view(scene.visual, name)
        use_backend()
        self._scene, self._cameras, self._looks = scene, cameras, looks
        self._threads = threads
        self._canvases: list[InGLThread[SceneCanvas]] = []

    def draw(self, states: Array, looks: Array | None = None) -> dict[str, Array]:
        """Draw states: part name -> uint8 [n, H, W, 3], bottom row first.

        Args:
            states: [n, S], state rows.
            looks: [n] int64, the seeds of the looks; of no effect without looks.
        """
        seeds = np.zeros(len(states), np.int64) if looks is None else looks
        shape = len(states), self._cameras.size, self._cameras.size, 3
        images = {part.name: np.empty(shape, np.uint8) for part in self._cameras.parts}
        shares = np.array_split(np.arange(len(states)), self._threads)
        futures = [
            canvas.post(_job(canvas.opened, states, seeds, images, rows))
            for canvas, rows in zip(self._opened(), shares, strict=True)
            if len(rows)
        ]
        for future in futures:
            future.result()
        return images

    def _opened(self) -> list[InGLThread[SceneCanvas]]:
        """One canvas a thread; new ones in a forked process."""
        if not all(canvas.alive for canvas in self._canvases):
            self._canvases = []
        for number in range(len(self._canvases), self._threads):
            self._canvases.append(InGLThread(self._new_canvas, number))
        return self._canvases

    def _new_canvas(self) -> SceneCanvas:
        return SceneCanvas(self._scene, self._cameras, self._looks)

    def __deepcopy__(self, memo: dict[int, Any]) -> "SceneCameras":
        """The object itself."""
        return self


def _job(
    canvas: SceneCanvas,
    states: Array,
    looks: Array,
    images: Mapping[str, Array],
    rows: Array,
) -> Callable[[], None]:
    return lambda: canvas.draw(states, looks, images, rows)
