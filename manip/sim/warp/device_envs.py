"""DeviceEnvs: N environments on the device, exchanged with the host as rows."""

from typing import Any, NamedTuple

import mujoco_warp as mjw
import numpy as np
import warp as wp

from manip.sim.scene import GAINS, Scene
from manip.sim.state_row import state_columns
from manip.sim.warp.captured import Captured
from manip.sim.warp.columns import Place, scatter
from manip.sim.warp.control_period import ControlPeriod
from manip.sim.warp.controller import Controller
from manip.sim.warp.device_model import (
    device_data,
    device_model,
    host_model,
    model_place,
    model_slots,
)
from manip.sim.warp.result_rows import ResultRows
from manip.sim.warp.sizes import Sizes
from manip.sim.warp.static_geoms import StaticGeoms

Array = np.ndarray


class Upload(NamedTuple):
    """Memory on the device for state rows [N, S] float32 and their environments [N]."""

    rows: Any
    env_ids: Any


class DeviceEnvs:
    """N environments of a scene, on the present device of Warp.

    Attributes:
        model, data: of mujoco_warp.
        controller: the control laws.
        results: the rows that `step`, `forward` and `put` fill.
    """

    def __init__(self, scene: Scene, num_envs: int, sizes: Sizes) -> None:
        host = host_model(scene)
        self.model = device_model(scene, host, num_envs, sizes)
        self.data = device_data(host, num_envs, sizes)
        self.controller = Controller(scene, self.data)
        self.results = ResultRows(scene, self.data, self.controller)
        self._places = _places(scene, self.model, self.data, self.controller)
        self._static = StaticGeoms(scene, host)
        self._period = ControlPeriod(
            self.model, self.data, self.controller, self.results, scene.substeps
        )
        width = sum(size for _, _, size in _parts(scene))
        self._upload = Upload(
            wp.zeros((num_envs, width), dtype=float), wp.zeros(num_envs, dtype=int)
        )
        self._put = wp.zeros_like(self.results.present)
        self._chosen = wp.zeros(num_envs, dtype=int)
        self._launch_forward = Captured(self._forward)
        self._warmstart = wp.zeros_like(self.data.qacc_warmstart)

    def step(self, action: Array) -> None:
        """Take one control period; action [N, A]."""
        self._period.run(action)

    def write(self, env_ids: Array, rows: Array) -> None:
        """Set the states of some environments to rows [n, S]."""
        width = self._upload.rows.shape[1]
        _send(np.ascontiguousarray(rows[:, :width], np.float32), self._upload.rows)
        _send(env_ids.astype(np.int32), self._upload.env_ids)
        for at, place in self._places:
            scatter(self._upload.rows, at, self._upload.env_ids, len(env_ids), place)
        self._static.pose(self.model, self.data)

    def put(self, env_ids: Array, rows: Array) -> None:
        """Set the present result rows of some environments to rows [n, W]."""
        _send(np.ascontiguousarray(rows, np.float32), self._put)
        _send(env_ids.astype(np.int32), self._upload.env_ids)
        place = Place(self.results.present)
        scatter(self._put, 0, self._upload.env_ids, len(env_ids), place)

    def forward(self, env_ids: Array) -> None:
        """Run `mj_forward` in some environments, with ctrl 0: warm start, readings."""
        chosen = np.zeros(self.data.nworld, np.int32)
        chosen[env_ids] = 1
        _send(chosen, self._chosen)
        self._launch_forward()

    def _forward(self) -> None:
        inputs = [self._chosen, self.data.ctrl, self.controller.state.peaks]
        wp.launch(_release, dim=self.data.nworld, inputs=inputs)
        wp.copy(self._warmstart, self.data.qacc_warmstart)
        self.results.clear_demand()
        mjw.forward(self.model, self.data)
        self.results.record_demand()
        inputs = [self._chosen, self._warmstart, self.data.qacc_warmstart]
        wp.launch(_keep_others, dim=self.data.nworld, inputs=inputs)
        self.results.fill()
        self.results.accept(self._chosen)

    @property
    def device_bytes_per_env(self) -> float:
        """Memory of mujoco_warp's Data, which grows with the number of environments."""
        return _bytes_of(self.data) / self.data.nworld


@wp.kernel(enable_backward=False)
def _release(
    chosen: wp.array[int],
    ctrl: wp.array2d[float],
    peaks: wp.array2d[float],
) -> None:
    """Set ctrl and peaks of the chosen environments to 0."""
    env = wp.tid()
    if chosen[env] != 0:
        for k in range(ctrl.shape[1]):
            ctrl[env, k] = 0.0
        for k in range(peaks.shape[1]):
            peaks[env, k] = 0.0


@wp.kernel(enable_backward=False)
def _keep_others(
    chosen: wp.array[int],
    before: wp.array2d[float],
    warmstart: wp.array2d[float],
) -> None:
    """Give environments that were not chosen their warm start back."""
    env = wp.tid()
    if chosen[env] == 0:
        for k in range(warmstart.shape[1]):
            warmstart[env, k] = before[env, k]


def _parts(scene: Scene) -> list[tuple[str, int, int]]:
    """(name, first column, size) of what a state row holds before the memory."""
    return [
        (name, columns.start, columns.stop - columns.start)
        for name, columns in state_columns(scene).items()
        if name not in scene.layout.memory
    ]


def _places(
    scene: Scene, model: Any, data: Any, controller: Controller
) -> list[tuple[int, Place]]:
    """(column of a state row, its place on the device)."""
    arrays = [data.qpos, data.qvel, data.qacc_warmstart]
    arrays += [controller.state.q0, controller.command]
    places: list[Place | None] = [Place(array) for array in arrays if array.size]
    parts = [part for part in _parts(scene) if part[2]]
    places += [model_place(model, slot) for slot in model_slots(scene)]
    if any(slot.array == GAINS for slot in scene.varied):
        places[-1] = Place(controller.state.gains)
    return [
        (start, place)
        for (_, start, _), place in zip(parts, places, strict=True)
        if place is not None
    ]


def _send(values: Array, target: Any) -> None:
    """Copy values to the beginning of an array on the device."""
    if values.size:
        source = wp.array(values.ravel(), dtype=target.dtype, device="cpu", copy=False)
        wp.copy(target.flatten(), source, count=values.size)


def _bytes_of(data: Any) -> int:
    """Bytes of all arrays of a mujoco_warp.Data."""
    values = [*vars(data).values(), *vars(data.contact).values()]
    values += vars(data.efc).values()
    return sum(v.capacity for v in values if isinstance(v, wp.array))
