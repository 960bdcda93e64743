"""SceneCameras: pictures of a scene's states, equal to robosuite's camera observations.

robosuite draws a camera while the last substep of a control step is observed: the
positions of bodies are those before the last integration (as in the readings), while
qpos and qvel have been integrated. The positions are found again by integrating
back over one timestep; at the start of an episode qvel is 0, and nothing changes.

The lean quality leaves out the floor's and the table's reflections (1 % of their
colour), geoms that lie outside a camera's field of view, and triangles of the arm's
meshes (see `manip.sim.thin_meshes`).
"""

import weakref
from collections.abc import Mapping
from copy import copy
from typing import Any

import mujoco
import numpy as np

from manip.cameras import CameraConfig, part_name
from manip.sim.canvas import Canvas, camera_view
from manip.sim.fields import write_slot
from manip.sim.frustum import Frustum
from manip.sim.gl import use_backend
from manip.sim.gl_thread import GLThread, close_later, gl_thread, open_in_gl_thread
from manip.sim.not_copied import NotCopied
from manip.sim.scene import Scene
from manip.sim.state_row import state_columns
from manip.sim.thin_meshes import thin_arm_meshes

Array = np.ndarray

_COLLISION, _VISUAL = 0, 1
"""Geom groups of robosuite: it draws the visual one (environments/base.py)."""


class SceneCameras(NotCopied):
    """Draw states of a scene; the OpenGL context stays open between calls.

    A deep copy is the object itself: it holds no state of an environment.

    Args:
        scene: what is drawn.
        cameras: the cameras, and the size of the pictures.

    Raises:
        UserError: a camera does not exist, or no OpenGL backend works here.
    """

    def __init__(self, scene: Scene, cameras: CameraConfig) -> None:
        self._views = {
            part_name(n): camera_view(scene.visual, n) for n in cameras.names
        }
        use_backend()
        self._scene, self._shape = scene, (cameras.size, cameras.size, 3)
        self._columns = state_columns(scene)
        self._lean = cameras.quality == "lean"
        self._model = _drawn_model(scene, cameras.size, self._lean)
        self._data = mujoco.MjData(self._model)
        self._options = _stock_options()
        self._frustums = {
            name: Frustum(self._model, self._data, view.fixedcamid)
            for name, view in self._views.items()
        }
        self._canvas: Canvas | None = None
        self._thread: GLThread | None = None

    def draw(self, states: Array) -> dict[str, Array]:
        """Draw state rows [n, S]: part name -> uint8 [n, H, W, 3], bottom row first."""
        pictures = {
            name: np.empty((len(states), *self._shape), np.uint8)
            for name in self._views
        }
        canvas = self._opened()
        gl_thread().call(lambda: self._fill(canvas, states, pictures))
        return pictures

    def _opened(self) -> Canvas:
        """The canvas; a new one in a forked process."""
        thread = gl_thread()
        if self._canvas is None or self._thread is not thread:
            size = self._shape[0]
            self._canvas = open_in_gl_thread(lambda: Canvas(self._model, size, size))
            reflection = mujoco.mjtRndFlag.mjRND_REFLECTION
            self._canvas.scene.flags[reflection] = not self._lean
            self._thread = thread
            weakref.finalize(self, close_later, self._canvas).atexit = False
        return self._canvas

    def _fill(
        self, canvas: Canvas, states: Array, pictures: Mapping[str, Array]
    ) -> None:
        for row, state in enumerate(states):
            self._pose(state)
            for name, view in self._views.items():
                if self._lean:
                    self._frustums[name].hide_unseen()
                canvas.draw(self._data, view, self._options, pictures[name][row])

    def _pose(self, state: Array) -> None:
        model, data, columns = self._model, self._data, self._columns
        for slot in self._scene.layout.fields:
            write_slot(model, slot, state[columns[slot.name]])
        data.qpos[:] = state[columns["qpos"]]
        timestep = self._scene.physics.opt.timestep
        mujoco.mj_integratePos(model, data.qpos, state[columns["qvel"]], -timestep)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_camlight(model, data)

    def __deepcopy__(self, memo: dict[int, Any]) -> "SceneCameras":
        """The object itself."""
        return self


def _drawn_model(scene: Scene, size: int, lean: bool) -> mujoco.MjModel:
    """A copy of the stock model as robosuite draws it after a reset."""
    model = copy(scene.visual)
    model.site_rgba[:] = hidden_site_colours(scene.stock)
    if lean:
        thin_arm_meshes(model)
    screen = model.vis.global_
    screen.offwidth = screen.offheight = size
    return model


def hidden_site_colours(stock: Any) -> Array:
    """[nsite, 4]: the sites' colours after a reset, which hides the robot's marks."""
    colours = stock.sim.model._model.site_rgba
    before = colours.copy()
    stock.visualize(vis_settings=dict.fromkeys(stock._visualizations, False))
    hidden: Array = colours.copy()
    colours[:] = before
    return hidden


def _stock_options() -> mujoco.MjvOption:
    options = mujoco.MjvOption()
    options.geomgroup[_COLLISION], options.geomgroup[_VISUAL] = 0, 1
    return options
