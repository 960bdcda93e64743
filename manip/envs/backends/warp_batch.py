"""WarpBatch: N environments of a task on MuJoCo Warp."""

from typing import TYPE_CHECKING, Any

from manip.envs.backends.native_batch import NativeBatch
from manip.envs.task import Measures, Task
from manip.sim.row_engine import RowEngine
from manip.sim.warp.library import Device, check_library
from manip.sim.warp.sizes import sizes_of

if TYPE_CHECKING:
    from manip.sim.warp.warp_engine import WarpEngine


class WarpBatch(NativeBatch):
    """Step N environments with MuJoCo Warp, on an NVIDIA GPU or on one CPU core.

    Resets are drawn on the host. docs/gpu.md says how this backend differs from the
    native one.

    Args:
        task: the task.
        num_envs: N.
        device: cuda or cpu; cuda unless given.
        njmax: constraint rows of an environment to allocate; as measured unless given.
        nconmax: contacts of an environment to allocate, on average; as measured unless
            given.
        tensors: evaluate the task with torch on the device, if it takes tensors and
            has no memory, and there are no perturbations: `gives_tensors`. Otherwise
            the task runs in numpy on the host.
        options: as in `NativeBatch`.

    Raises:
        UserError: as `NativeBatch`; or a package or a CUDA device is missing. A step
            raises it where njmax or nconmax is too small.
    """

    engine: "WarpEngine"

    def __init__(
        self,
        task: Task,
        num_envs: int,
        *,
        device: Device | None = None,
        njmax: int | None = None,
        nconmax: int | None = None,
        tensors: bool = False,
        **options: Any,
    ) -> None:
        able = task.takes_tensors and not task.sensors.memory
        self.gives_tensors = tensors and able and not options.get("perturbations")
        self.device: Device = device or "cuda"
        check_library(self.device)
        self._sizes = njmax, nconmax
        super().__init__(task, num_envs, **options)

    def _task_reads(self) -> Measures:
        return self.engine.tensors() if self.gives_tensors else self.read()

    def _build_engine(self, num_envs: int, threads: int | None) -> RowEngine:
        from manip.sim.warp.warp_engine import WarpEngine  # needs the extra `gpu`

        sizes = sizes_of(self.scene, *self._sizes)
        return WarpEngine(self.scene, num_envs, sizes, self.device, threads)
