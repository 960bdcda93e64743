"""Physics without control laws: the bound that the engine's speed is compared with."""

from collections.abc import Callable

import mujoco_warp as mjw
import warp as wp

from manip.sim.warp.captured import Captured
from manip.sim.warp.warp_engine import WarpEngine


def bare_steps(engine: WarpEngine) -> Callable[[], None]:
    """Build a function that steps mujoco_warp for one control period, and waits for it.

    The engine's environments move with constant controls: do not use it afterwards
    without a reset.
    """
    model, data = engine.on_device.model, engine.on_device.data

    def period() -> None:
        for _ in range(engine.scene.substeps):
            mjw.step(model, data)

    launch = Captured(period)

    def run() -> None:
        with wp.ScopedDevice(engine.device) as device:
            launch()
            if device.is_cuda:
                wp.synchronize_device(device)

    return run
