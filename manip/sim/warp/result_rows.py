"""ResultRows: states and readings of all environments, one row each, on the device."""

from typing import Any, NamedTuple

import numpy as np
import warp as wp

from manip.sim.scene import Scene
from manip.sim.state_row import readings_width, touch_start
from manip.sim.warp.columns import flat, gather
from manip.sim.warp.controller import Controller

Array = np.ndarray


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


@wp.kernel(enable_backward=False)
def _copy_rows(
    rows: wp.array2d[float],
    flags: wp.array[int],
    wanted: int,
    target: wp.array2d[float],
) -> None:
    env, k = wp.tid()
    if flags[env] == wanted:
        target[env, k] = rows[env, k]


class PeriodStatus(NamedTuple):
    """What the host reads after each control period.

    Attributes:
        broken: [N] bool, environments that are broken.
        rows: the most constraint rows of any environment.
        contacts: the most contacts of all environments together.
    """

    broken: Array
    rows: int
    contacts: int


class ResultRows:
    """Rows [N, W] float32: results of a control period, and those that are present.

    A row holds the part of the state that a step changes (qpos, qvel, warm start,
    start_pos, gripper command), and the readings.

    Attributes:
        state_width: length of the part of the state.
        present: rows of the present states, on the device.
        before: those before the last step.
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
        self._touch_at = self.state_width + touch_start(scene)
        shape = num_envs, self.state_width + readings_width(scene)
        self._rows, self.present, self.before = (
            wp.zeros(shape, dtype=float) for _ in range(3)
        )
        pinned = self._rows.device.is_cuda
        self._host = wp.zeros(shape, dtype=float, device="cpu", pinned=pinned)

    def clear_demand(self) -> None:
        """Begin to record the demand of `read_status`."""
        self._demand.zero_()

    def record_demand(self) -> None:
        """Record the constraint rows and contacts of the present substep."""
        data = self._data
        counts = [data.nefc, data.nacon, data.ncollision, self._demand]
        wp.launch(_record_demand, dim=data.nworld, inputs=counts)

    def fill(self) -> None:
        """Compute the results from the present state of mujoco_warp's Data."""
        rows, at = self._rows, 0
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

    def read_status(self) -> PeriodStatus:
        """Wait for the device, and copy the status to the host."""
        rows, contacts = self._demand.numpy()
        return PeriodStatus(self._broken.numpy() != 0, int(rows), int(contacts))

    def accept_step(self) -> None:
        """Make the results of unbroken environments the present rows."""
        wp.copy(self.before, self.present)
        self._accept(self._broken, 0)

    def accept(self, chosen: Any) -> None:
        """Make the results the present rows where chosen [N] int is 1."""
        self._accept(chosen, 1)

    def _accept(self, flags: Any, wanted: int) -> None:
        inputs = [self._rows, flags, wanted, self.present]
        wp.launch(_copy_rows, dim=self._rows.shape, inputs=inputs)

    def to_host(self, rows: Any) -> Array:
        """[N, W]: a copy of `present` or `before`; valid until the next call."""
        wp.copy(self._host, rows)
        if rows.device.is_cuda:
            wp.synchronize_device(rows.device)
        copied: Array = self._host.numpy()
        return copied
