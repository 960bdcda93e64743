"""DeviceReadings: the present readings of a WarpEngine, as torch tensors."""

from typing import Any

import numpy as np
import warp as wp

from manip.arrays import constant
from manip.sim.scene import Scene
from manip.sim.scene_layout import constant_readings, with_joints
from manip.sim.state_row import reading_columns, state_columns
from manip.sim.warp.result_rows import ResultRows

Array = np.ndarray

OF_STATE = ("start_pos", "gripper_command")
"""Parts of the state that are readings, too."""


class DeviceReadings:
    """Tensors [N, k] float64 on the device, named as the arrays of `RowEngine.read`.

    Model fields and memory are not among them. A number that holds for all
    environments stays an array of the host.
    """

    def __init__(self, scene: Scene, results: ResultRows) -> None:
        self._layout, self._rows = scene.layout, wp.to_torch(results.present)
        state, first = state_columns(scene), results.state_width
        self._columns: dict[str, Any] = {name: state[name] for name in OF_STATE}
        for name, place in reading_columns(scene).items():
            self._columns[name] = _shifted(place, first)
        self._constants = {
            name: constant(values, self._rows) if values.size > 1 else values
            for name, values in constant_readings(scene.layout).items()
        }

    def read(self) -> dict[str, Any]:
        """Copies of the present readings."""
        rows = self._rows.double()
        named = {name: rows[:, columns] for name, columns in self._columns.items()}
        return with_joints(self._layout, {**named, **self._constants})


def _shifted(place: slice | int, by: int) -> slice | int:
    if isinstance(place, int):
        return place + by
    return slice(place.start + by, place.stop + by)
