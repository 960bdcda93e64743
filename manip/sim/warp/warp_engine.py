"""WarpEngine: step N environments of one scene with MuJoCo Warp."""

from typing import Any, Self

import numpy as np
import warp as wp

from manip.cpus import usable_cpus
from manip.sim.row_engine import Buffer, RowEngine
from manip.sim.scene import Scene
from manip.sim.warp.device_envs import DeviceEnvs
from manip.sim.warp.library import Device, check_library
from manip.sim.warp.result_rows import BROKEN, CONTACTS, FIRST, ROWS
from manip.sim.warp.sizes import Sizes, check_demand

Array = np.ndarray


class WarpEngine(RowEngine):
    """Step N environments of a scene with MuJoCo Warp; implements `Engine`.

    Simulation is in float32, and control laws in float64. Rows of states and readings
    are float64 copies on the host. Differences from `BatchEngine`: docs/gpu.md.

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

    def _advance(self, actions: Array, now: Buffer, after: Buffer) -> None:
        with wp.ScopedDevice(self.device):
            self._envs.step(actions)
            rows = self._envs.results.to_host()
        self._check_demand(rows)
        self.broken[:] = rows[:, BROKEN] != 0
        after.states[:], after.readings[:] = now.states, now.readings
        self._take(rows, np.flatnonzero(~self.broken), after)

    def _refresh(self, env_ids: Array) -> None:
        if len(env_ids):
            self._check_demand(self._forward(env_ids))

    def _forward(self, env_ids: Array) -> Array:
        """Send rows, run `mj_forward` and take its readings; return the result rows."""
        self._restored(env_ids)
        with wp.ScopedDevice(self.device):
            self._envs.forward(env_ids)
            rows = self._envs.results.to_host()
        self._take(rows, env_ids, self._now)
        return rows

    def _restored(self, env_ids: Array | slice) -> None:
        """Send rows to the device, and keep them as it has them: in float32."""
        states, chosen = self._now.states, np.arange(self.num_envs)[env_ids]
        sent = states[chosen, : self._memory_at].astype(np.float32)
        states[chosen, : self._memory_at] = sent
        with wp.ScopedDevice(self.device):
            self._envs.write(chosen, sent)

    def _take(self, rows: Array, env_ids: Array, into: Buffer) -> None:
        """Copy states and readings of some environments out of result rows."""
        middle = FIRST + self._envs.results.state_width
        into.states[env_ids, : middle - FIRST] = rows[env_ids, FIRST:middle]
        into.readings[env_ids] = rows[env_ids, middle:]

    def _check_demand(self, rows: Array) -> None:
        needed = int(rows[0, ROWS]), int(rows[0, CONTACTS])
        self.demand = Sizes(
            max(self.demand.njmax, needed[0]),
            max(self.demand.nconmax, -(-needed[1] // self.num_envs)),
        )
        try:
            check_demand(self.sizes, self.num_envs, *needed)
        except Exception:
            self._restored(slice(None))
            raise

    def _another(self) -> Self:
        options: dict[str, Any] = {"device": self.device, "threads": self.threads}
        return type(self)(self.scene, self.num_envs, self.sizes, **options)
