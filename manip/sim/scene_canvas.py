"""SceneCanvas: draw a scene's states as robosuite's camera observations, in one thread.

robosuite draws a camera while the last substep of a control step is observed: the
positions of bodies are those before the last integration (as in the readings), while
qpos and qvel have been integrated. The positions are found again by integrating
back over one timestep; at the start of an episode qvel is 0, and nothing changes.

The lean quality leaves out the floor's and the table's reflections (1 % of their
colour), geoms that lie outside a camera's field of view, and triangles of the arm's
meshes (see `manip.sim.thin_meshes`).
"""

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np

from manip.cameras import CameraConfig, part_name
from manip.looks import Looks
from manip.sim.canvas import Canvas, camera_view
from manip.sim.fields import write_slot
from manip.sim.frustum import Frustum
from manip.sim.look import Look
from manip.sim.scene import Scene
from manip.sim.state_row import state_columns
from manip.sim.textured_model import textured_model
from manip.sim.thin_meshes import thin_arm_meshes

Array = np.ndarray

_COLLISION, _VISUAL = 0, 1
"""Geom groups of robosuite: it draws the visual one (environments/base.py)."""


class SceneCanvas:
    """A model, data and OpenGL context to draw a scene's states in one thread.

    Args:
        scene: what is drawn.
        cameras: the cameras, the size and the quality of the images.
        looks: what varies between episodes.
    """

    def __init__(self, scene: Scene, cameras: CameraConfig, looks: Looks) -> None:
        self._scene, self._columns = scene, state_columns(scene)
        self._lean = cameras.quality == "lean"
        self._model, textures = textured_model(scene, varied=bool(looks.groups))
        _show_as_stock(self._model, scene.stock, cameras.size)
        if self._lean:
            thin_arm_meshes(self._model)
        self._look = Look(self._model, textures, looks)
        self._data = mujoco.MjData(self._model)
        self._options = _stock_options()
        views = {name: camera_view(self._model, name) for name in cameras.names}
        self._views = {
            part_name(name): (view, Frustum(self._model, self._data, view.fixedcamid))
            for name, view in views.items()
        }
        self._canvas = Canvas(self._model, cameras.size, cameras.size)
        self._canvas.reflect(not self._lean)

    def draw(
        self,
        states: Array,
        looks: Array,
        images: Mapping[str, Array],
        rows: Array,
    ) -> None:
        """Draw some of the state rows [n, S] into the same rows of images.

        Args:
            states: [n, S].
            looks: [n] int64, the seeds of the looks.
            images: part name -> uint8 [n, H, W, 3], bottom row first.
            rows: [k] int.
        """
        for row in rows:
            self._look.apply(int(looks[row]))
            self._canvas.set_textures(self._model.mat_texid)
            self._pose(states[row])
            for name, (view, frustum) in self._views.items():
                if self._lean:
                    frustum.hide_unseen()
                self._canvas.draw(self._data, view, self._options, images[name][row])

    def close(self) -> None:
        """Free the OpenGL context."""
        self._canvas.close()

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


def _show_as_stock(model: mujoco.MjModel, stock: Any, size: int) -> None:
    """Hide the sites that robosuite hides, and make room for the images."""
    model.site_rgba[:] = _hidden_site_colours(stock)
    screen = model.vis.global_
    screen.offwidth = screen.offheight = size


def _hidden_site_colours(stock: Any) -> Array:
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
