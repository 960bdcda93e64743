"""Physics without control laws: the bound that the engine's speed is compared with."""

from collections.abc import Callable

import mujoco_warp as mjw
import warp as wp

from manip.sim.warp.warp_engine import WarpEngine


def bare_steps(engine: WarpEngine) -> Callable[[], None]:
    """Build a function that steps mujoco_warp for one control period, and waits for it.

    The engine's environments move with constant controls: do not use it afterwards
    without a reset. On CUDA, the period is a captured graph.
    """
    model, data = engine.on_device.model, engine.on_device.data

    def launch() -> None:
        for _ in range(engine.scene.substeps):
            mjw.step(model, data)

    with wp.ScopedDevice(engine.device) as device:
        launch()
        if device.is_cuda:
            with wp.ScopedCapture() as capture:
                launch()

    def run() -> None:
        if device.is_cuda:
            wp.capture_launch(capture.graph)
            wp.synchronize_device(device)
        else:
            launch()

    return run
