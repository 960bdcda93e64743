"""What one thread steps worlds in: its own model, data and scratch."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from manip.sim.control_laws import Work, new_work
from manip.sim.scene import Scene
from manip.sim.slots import Slot
from manip.sim.stepping import Places, Sim

Array = np.ndarray


@dataclass(frozen=True)
class ThreadData:
    """A thread's own MjModel and MjData, kept alive while `sim` points into them."""

    model: mujoco.MjModel
    data: mujoco.MjData
    sim: Sim
    work: Work


def thread_data(scene: Scene) -> ThreadData:
    """Memory for one more thread to step worlds of the scene in."""
    model = mujoco.MjModel.__copy__(scene.physics)
    data = mujoco.MjData(model)
    work = new_work(len(scene.layout.arm.dof))
    command = np.zeros(len(scene.layout.gripper.actuator))
    sim = Sim(
        model=model._address,
        data=data._address,
        state=_places(
            data.qpos,
            data.qvel,
            data.qacc_warmstart,
            work.q0,
            command,
            *_runs(model, scene.layout.fields),
        ),
        slots=_places(*_runs(data, scene.layout.slots)),
        command=command,
        qpos=data.qpos,
        qvel=data.qvel,
        ctrl=data.ctrl,
        mass=data.M,
        bias=data.qfrc_bias,
        cdof=data.cdof,
        com=data.subtree_com,
        site_xpos=data.site_xpos,
        site_xmat=data.site_xmat,
        found=data.sensordata,
    )
    return ThreadData(model, data, sim, work)


def _runs(owner: Any, slots: tuple[Slot, ...]) -> Iterator[Array]:
    """Views of the entries that the slots name."""
    for slot in slots:
        flat = getattr(owner, slot.array).reshape(-1)
        yield flat[slot.start : slot.start + slot.size]


def _places(*runs: Array) -> Places:
    addresses = [run.ctypes.data for run in runs]
    return Places(np.array(addresses, np.int64), np.array([run.size for run in runs]))
