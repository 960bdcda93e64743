"""A window of MuJoCo's passive viewer."""

import os
import warnings
from typing import Any

import mujoco
import numpy as np

from manip.errors import UserError, one_line
from manip.sim.renderer import WORKSPACE, hide_decorations, own_view

Array = np.ndarray


class Window:
    """Show poses of a model in a window.

    Args:
        model: robosuite's full model; it is copied.

    Raises:
        UserError: no window can be opened.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        os.environ.pop("MUJOCO_GL", None)  # a backend without windows
        self._model = mujoco.MjModel.__copy__(model)
        hide_decorations(self._model)
        self._data = mujoco.MjData(self._model)
        self._viewer = _open(self._model, self._data)
        view = own_view(WORKSPACE)
        self._viewer.cam.lookat[:] = view[:3]
        self._viewer.cam.distance, self._viewer.cam.azimuth = view[3:5]
        self._viewer.cam.elevation = view.elevation
        self._viewer.opt.geomgroup[:] = [0, 1, 0, 0, 0, 0]

    @property
    def open(self) -> bool:
        """Whether the user has not closed the window."""
        return bool(self._viewer.is_running())

    def show(self, pose: Array) -> None:
        """Show a pose, qpos [nq]."""
        with self._viewer.lock():
            self._data.qpos[:] = pose
            mujoco.mj_forward(self._model, self._data)
        self._viewer.sync()

    def close(self) -> None:
        """Close the window."""
        self._viewer.close()


def _open(model: mujoco.MjModel, data: mujoco.MjData) -> Any:
    import glfw  # which searches for its library when it is imported
    from mujoco import viewer

    with warnings.catch_warnings(action="ignore"):
        if not glfw.init():  # without it, mujoco's viewer ends the process
            raise _no_window("GLFW does not find a display")
    try:
        return viewer.launch_passive(
            model, data, show_left_ui=False, show_right_ui=False
        )
    except Exception as error:  # mujoco raises many kinds
        raise _no_window(one_line(error)) from error


def _no_window(reason: str) -> UserError:
    return UserError(
        f"no window can be opened: {reason}; use `manip render`, which writes a video "
        "(on macOS, start with mjpython)"
    )
