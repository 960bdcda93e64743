"""WarpBatch: N environments of a task on MuJoCo Warp."""

from typing import Any

from manip.envs.backends.native_batch import NativeBatch
from manip.envs.task import Task
from manip.sim.row_engine import RowEngine
from manip.sim.warp.library import Device, check_library
from manip.sim.warp.sizes import sizes_of


class WarpBatch(NativeBatch):
    """Step N environments with MuJoCo Warp, on an NVIDIA GPU or on one CPU core.

    Tasks, rewards and resets run in numpy on the host. docs/gpu.md says how this
    backend differs from the native one.

    Args:
        task: the task.
        num_envs: N.
        device: cuda or cpu; cuda unless given.
        njmax: constraint rows of an environment to allocate; as measured unless given.
        nconmax: contacts of an environment to allocate, on average; as measured unless
            given.
        options: as in `NativeBatch`.

    Raises:
        UserError: as `NativeBatch`; or a package or a CUDA device is missing. A step
            raises it where njmax or nconmax is too small.
    """

    def __init__(
        self,
        task: Task,
        num_envs: int,
        *,
        device: Device | None = None,
        njmax: int | None = None,
        nconmax: int | None = None,
        **options: Any,
    ) -> None:
        self.device: Device = device or "cuda"
        check_library(self.device)
        self._sizes = njmax, nconmax
        super().__init__(task, num_envs, **options)

    def _build_engine(self, num_envs: int, threads: int | None) -> RowEngine:
        from manip.sim.warp.warp_engine import WarpEngine  # needs the extra `gpu`

        sizes = sizes_of(self.scene, *self._sizes)
        return WarpEngine(self.scene, num_envs, sizes, self.device, threads)
