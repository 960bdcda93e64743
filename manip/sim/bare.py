"""MuJoCo's own speed: the bound that the batch engine is measured against."""

from collections.abc import Callable

import mujoco

from manip.sim.model import Scene


def bare_physics(scene: Scene, steps: int) -> Callable[[], int]:
    """A function that runs `mj_step` alone from the start pose, without control.

    Returns:
        A function that takes `steps` control steps' worth of substeps and returns
        their number.
    """
    data = mujoco.MjData(scene.physics)

    def run() -> int:
        mujoco.mj_resetData(scene.physics, data)
        data.qpos[:] = scene.handles.qpos
        mujoco.mj_step(scene.physics, data, nstep=steps * scene.substeps)
        return steps

    return run
