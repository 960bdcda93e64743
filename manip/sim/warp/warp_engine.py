"""WarpEngine: step N environments of one scene with MuJoCo Warp."""

from functools import cached_property
from typing import Any, Self

import numpy as np
import warp as wp

from manip.arrays import is_tensor
from manip.cpus import usable_cpus
from manip.errors import UserError
from manip.sim.engine import Snapshot
from manip.sim.row_engine import Buffer, RowEngine
from manip.sim.scene import Scene
from manip.sim.warp.device_envs import DeviceEnvs
from manip.sim.warp.device_readings import DeviceReadings
from manip.sim.warp.library import Device, check_library
from manip.sim.warp.result_rows import PeriodStatus
from manip.sim.warp.sizes import Sizes, check_demand

Array = np.ndarray


class WarpEngine(RowEngine):
    """Step N environments of a scene with MuJoCo Warp; implements `Engine`.

    Simulation is in float32, and control laws in float64. Rows of states and readings
    are on the device; the host has float64 copies, made when they are read.
    Differences from `BatchEngine`: docs/gpu.md.

    Args:
        scene: what is simulated.
        num_envs: N.
        sizes: constraint rows and contacts to allocate.
        device: of Warp.
        threads: native threads that draw images.

    Raises:
        UserError: there is no such device. Steps, resets and `set_state` raise it where
            the sizes are too small; a step then leaves the states from before.

    Attributes:
        demand: the largest sizes that were needed so far.
    """

    def __init__(
        self,
        scene: Scene,
        num_envs: int,
        sizes: Sizes,
        device: Device = "cuda",
        threads: int | None = None,
    ) -> None:
        check_library(device)
        super().__init__(scene, num_envs, threads or usable_cpus())
        self.device, self.sizes, self.demand = device, sizes, Sizes(0, 0)
        with wp.ScopedDevice(device):
            self._envs = DeviceEnvs(scene, num_envs, sizes)
        self._now_old = self._before_old = False
        self._memory_at = self._default.size - sum(scene.layout.memory.values())
        self._forward(np.arange(num_envs))  # objects may overlap in the default pose

    @property
    def on_device(self) -> DeviceEnvs:
        """The environments on the device, whose arrays may be read between steps."""
        return self._envs

    @property
    def device_bytes_per_env(self) -> int:
        """Memory of the device that one more environment takes, without scratch."""
        return round(self._envs.device_bytes_per_env)

    @property
    def before(self) -> Snapshot:
        """As `Engine.before`."""
        if self._before_old:
            self._copy_rows(self._envs.results.before, self._before)
            self._before_old = False
        return super().before

    @cached_property
    def _device_readings(self) -> DeviceReadings:
        return DeviceReadings(self.scene, self._envs.results)

    def tensors(self) -> dict[str, Any]:
        """The present readings as torch tensors on the device, see `DeviceReadings`."""
        with self._exclusive:
            self._wait()  # torch has other streams than Warp
            return self._device_readings.read()

    def _checked(self, action: Any) -> Any:
        """Actions of the host, checked; or a tensor [N, A] on the device."""
        if not is_tensor(action):
            return super()._checked(action)
        expected = self.num_envs, self.scene.layout.action_dim
        if tuple(action.shape) != expected:
            raise UserError(
                f"the action has shape {tuple(action.shape)}, expected {expected}"
            )
        self._wait()
        return action

    def _wait(self) -> None:
        """Wait for all work on the device, of Warp and of torch."""
        device = wp.get_device(self.device)
        if device.is_cuda:
            wp.synchronize_device(device)

    def _advance(self, actions: Array, now: Buffer, after: Buffer) -> None:
        with wp.ScopedDevice(self.device):
            self._envs.step(actions)
            status = self._envs.results.read_status()
            self._check_demand(status)
            self._envs.results.accept_step()
        self.broken[:] = status.broken
        after.states[:] = now.states  # fields and memory: a step does not change them
        self._now_old = self._before_old = True

    def _fetch(self) -> None:
        if self._now_old:
            self._copy_rows(self._envs.results.present, self._now)
            self._now_old = False

    def _copy_rows(self, rows: Any, into: Buffer) -> None:
        with wp.ScopedDevice(self.device):
            copied = self._envs.results.to_host(rows)
        width = self._envs.results.state_width
        into.states[:, :width], into.readings[:] = copied[:, :width], copied[:, width:]

    def _refresh(self, env_ids: Array) -> None:
        if len(env_ids):
            self._check_demand(self._forward(env_ids))

    def _forward(self, env_ids: Array) -> PeriodStatus:
        """Send rows, run `mj_forward`, and make its results the present rows."""
        self._send(env_ids)
        with wp.ScopedDevice(self.device):
            self._envs.forward(env_ids)
            status = self._envs.results.read_status()
        self._now_old = True
        return status

    def _restored(self, env_ids: Array | slice) -> None:
        states, width = self._send(env_ids), self._envs.results.state_width
        rows = np.hstack([states[:, :width], self._now.readings[env_ids]])
        with wp.ScopedDevice(self.device):
            self._envs.put(np.arange(self.num_envs)[env_ids], rows)

    def _send(self, env_ids: Array | slice) -> Array:
        """Send rows to the device, and keep and return them as it has them: float32."""
        states, chosen = self._now.states, np.arange(self.num_envs)[env_ids]
        sent = states[chosen, : self._memory_at].astype(np.float32)
        states[chosen, : self._memory_at] = sent
        with wp.ScopedDevice(self.device):
            self._envs.write(chosen, sent)
        return sent

    def _check_demand(self, status: PeriodStatus) -> None:
        self.demand = Sizes(
            max(self.demand.njmax, status.rows),
            max(self.demand.nconmax, -(-status.contacts // self.num_envs)),
        )
        try:
            check_demand(self.sizes, self.num_envs, status.rows, status.contacts)
        except Exception:
            self._fetch()
            self._send(slice(None))
            raise

    def _another(self) -> Self:
        options: dict[str, Any] = {"device": self.device, "threads": self.threads}
        return type(self)(self.scene, self.num_envs, self.sizes, **options)
