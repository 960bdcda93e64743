"""ResultRows: the result of a control period, one row an environment, in one copy."""

from typing import Any

import numpy as np
import warp as wp

from manip.sim.scene import Scene
from manip.sim.state_row import readings_width, touch_start
from manip.sim.warp.columns import flat, gather, gather_numbers
from manip.sim.warp.controller import Controller

Array = np.ndarray

BROKEN, ROWS, CONTACTS, FIRST = range(4)
"""Columns: whether the environment is broken; the most constraint rows of any, and the
most contacts of all together, in the control period; the first one of the state."""


@wp.kernel(enable_backward=False)
def _count_touches(
    sensordata: wp.array2d[float],
    touch_of_sensor: wp.array[int],
    limit: wp.array[float],
    rows: wp.array2d[float],
    at: int,
) -> None:
    env = wp.tid()
    for touch in range(limit.shape[0]):
        rows[env, at + touch] = 0.0
    for k in range(touch_of_sensor.shape[0]):
        touch = touch_of_sensor[k]
        total = rows[env, at + touch] + sensordata[env, k]
        rows[env, at + touch] = wp.min(limit[touch], total)


@wp.kernel(enable_backward=False)
def _record_demand(
    nefc: wp.array[int],
    nacon: wp.array[int],
    ncollision: wp.array[int],
    demand: wp.array[int],
) -> None:
    """Keep the most constraint rows of an environment, and contacts of all of them."""
    env = wp.tid()
    wp.atomic_max(demand, 0, nefc[env])
    if env == 0:
        wp.atomic_max(demand, 1, wp.max(nacon[0], ncollision[0]))


class ResultRows:
    """Rows [N, W] float32 on the device, and their copy on the host.

    A row holds the columns above, the part of the state that a step changes (qpos,
    qvel, warm start, start_pos, gripper command), and the readings.

    Attributes:
        state_width: length of the part of the state.
    """

    def __init__(self, scene: Scene, data: Any, controller: Controller) -> None:
        state, num_envs = controller.state, data.nworld
        self._demand = wp.zeros(2, dtype=int)
        self._broken, self._data = state.broken, data
        self._parts = [data.qpos, data.qvel, data.qacc_warmstart]
        self._parts += [state.q0, controller.command]
        self.state_width = sum(part.shape[1] for part in self._parts)
        slots = scene.layout.slots
        self._slots = [(slot, flat(getattr(data, slot.array))) for slot in slots]
        self._peaks = state.peaks if scene.with_peaks else None
        limits = np.array([t.limit for t in scene.layout.touches], np.float32)
        self._touches = (
            wp.array(scene.touch_of_sensor.astype(np.int32), dtype=int),
            wp.array(limits, dtype=float),
        )
        self._touch_at = FIRST + self.state_width + touch_start(scene)
        width = FIRST + self.state_width + readings_width(scene)
        self._rows = wp.zeros((num_envs, width), dtype=float)
        pinned = self._rows.device.is_cuda
        self._host = wp.zeros(
            (num_envs, width), dtype=float, device="cpu", pinned=pinned
        )

    def clear_demand(self) -> None:
        """Begin to record what the columns ROWS and CONTACTS hold."""
        self._demand.zero_()

    def record_demand(self) -> None:
        """Record the constraint rows and contacts of the present substep."""
        data = self._data
        counts = [data.nefc, data.nacon, data.ncollision, self._demand]
        wp.launch(_record_demand, dim=data.nworld, inputs=counts)

    def fill(self) -> None:
        """Compute the rows from the present state of mujoco_warp's Data."""
        rows, at = self._rows, FIRST
        gather_numbers(self._broken, rows, BROKEN)
        gather_numbers(self._demand[:1], rows, ROWS)
        gather_numbers(self._demand[1:], rows, CONTACTS)
        for part in self._parts:
            gather(part, 0, part.shape[1], rows, at)
            at += part.shape[1]
        for slot, array in self._slots:
            gather(array, slot.start, slot.size, rows, at)
            at += slot.size
        if self._peaks is not None:
            gather(self._peaks, 0, self._peaks.shape[1], rows, at)
        inputs = [self._data.sensordata, *self._touches, rows, self._touch_at]
        if len(self._touches[1]):
            wp.launch(_count_touches, dim=rows.shape[0], inputs=inputs)

    def to_host(self) -> Array:
        """[N, W]: the rows; valid until the next call."""
        wp.copy(self._host, self._rows)
        if self._rows.device.is_cuda:
            wp.synchronize_device(self._rows.device)
        rows: Array = self._host.numpy()
        return rows
