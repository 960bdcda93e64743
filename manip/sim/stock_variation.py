"""Vary physical quantities of a robosuite environment, as `SceneVariation` does."""

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np

from manip.sim.robot_model import read_robots
from manip.sim.scene_variation import CONTROLLER
from manip.sim.sensors import Sensors
from manip.sim.variation import CHANGES, check_change, gains, varied_parts

Array = np.ndarray

START_NOISE = "start_noise"
"""The quantity that multiplies the noise of the arm's start pose."""

_NOISE = 0.02  # robosuite's default standard deviation [rad] (robots/robot.py)


class StockVariation:
    """Reset a robosuite environment with other values of its quantities.

    Args:
        stock: the environment.
        sensors: of the task.
    """

    def __init__(self, stock: Any, sensors: Sensors) -> None:
        self._stock, self._sensors = stock, sensors
        self._compiled: list[tuple[Array, Array]] = []

    def before_reset(self, values: Mapping[str, float]) -> None:
        """Put the compiled values back, and set the noise of the start pose."""
        for array, compiled in self._compiled:
            array[:] = compiled
        self._compiled = []
        if START_NOISE in values:
            noise = {"magnitude": _NOISE * values[START_NOISE], "type": "gaussian"}
            for config in self._stock.robot_configs:
                config["initialization_noise"] = noise
            for robot in self._stock.robots:
                robot.initialization_noise = noise

    def after_reset(self, values: Mapping[str, float]) -> None:
        """Change model and controller, which a reset builds anew or restores.

        Raises:
            UserError: a quantity cannot vary.
        """
        stock = self._stock
        model, data = stock.sim.model._model, stock.sim.data._data
        parts = varied_parts(model, self._sensors, read_robots(stock))
        changes = [name for name in CHANGES if name in values]
        for name in changes:
            check_change(model, parts, name)
            arrays = [getattr(model, array) for array in CHANGES[name].arrays]
            self._compiled += [(array, array.copy()) for array in arrays]
            CHANGES[name].apply(model, parts, values[name])
        if changes:
            mujoco.mj_setConst(model, mujoco.MjData(model))
            mujoco.mj_forward(model, data)
        if CONTROLLER in values:
            for robot in stock.robots:
                part = robot.part_controllers["right"]
                part.kp, part.kd = gains(part.kp, part.kd, values[CONTROLLER])
