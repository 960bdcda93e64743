"""ControlPeriod: the kernels of one control period, in order."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp

from manip.arrays import is_tensor
from manip.sim.warp.captured import Captured
from manip.sim.warp.controller import Controller
from manip.sim.warp.env_guard import EnvGuard
from manip.sim.warp.result_rows import ResultRows

Array = np.ndarray

_SENSORS_OFF = int(mujoco.mjtDisableBit.mjDSBL_SENSOR)


class ControlPeriod:
    """Step all environments by one control period.

    It is robosuite's own sequence, as in `manip.sim.stepping`.

    Args:
        model, data: of mujoco_warp.
        controller: the control laws.
        results: the rows that a period fills.
        substeps: simulation steps in a period.
    """

    def __init__(
        self,
        model: Any,
        data: Any,
        controller: Controller,
        results: ResultRows,
        substeps: int,
    ) -> None:
        self._model, self._data, self._controller = model, data, controller
        self._results, self._substeps = results, substeps
        state = [data.qpos, data.qvel, data.qacc_warmstart, controller.command]
        self._guard = EnvGuard(state, controller.state.broken)
        self._action: Any = None
        self._launch = Captured(self._period)

    def run(self, action: Array) -> None:
        """Take one control period; action [N, A] on the host, or a torch tensor."""
        values = _floats(action)
        if self._action is None:
            self._action = wp.zeros(action.shape, dtype=float)
        wp.copy(self._action, values)
        self._launch()

    def _period(self) -> None:
        self._results.clear_demand()
        self._guard.save()
        for substep in range(self._substeps):
            with self._sensors(substep == self._substeps - 1):
                self._substep(substep)
        self._results.fill()

    def _substep(self, substep: int) -> None:
        model, data = self._model, self._data
        mjw.step1(model, data)
        if substep == 0:
            self._controller.latch(self._action)
        self._controller.drive()
        mjw.step2(model, data)
        self._guard.isolate()
        self._results.record_demand()

    @contextmanager
    def _sensors(self, on: bool) -> Iterator[None]:
        """Compute sensors in the last substep only, as nothing reads the others.

        mujoco_warp tests the flag on the host, before it launches the sensors' kernels.
        """
        flags = self._model.opt.disableflags
        self._model.opt.disableflags = flags if on else flags | _SENSORS_OFF
        yield
        self._model.opt.disableflags = flags


def _floats(action: Any) -> Any:
    """An action as an array of Warp, float32; a tensor's memory is shared."""
    if is_tensor(action):
        return wp.from_torch(action.detach().float().contiguous())
    return wp.array(action.astype(np.float32), dtype=float, device="cpu")
