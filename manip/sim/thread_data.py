"""The memory of one simulation thread: model, data and scratch arrays."""

from dataclasses import dataclass

import mujoco
import numpy as np

from manip.sim.control_laws import Works, new_works
from manip.sim.not_copied import NotCopied
from manip.sim.scene import GAINS, Scene
from manip.sim.sim_memory import Segments, Sim
from manip.sim.slots import Slot

Array = np.ndarray


@dataclass(frozen=True)
class ThreadData(NotCopied):
    """A thread's own MjModel and MjData.

    `sim` holds addresses inside the other members, which must exist as long as it.
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    sim: Sim
    works: Works
    fields: tuple[Array, ...]


def thread_data(scene: Scene) -> ThreadData:
    """Memory in which one more thread can step environments of the scene."""
    model = mujoco.MjModel.__copy__(scene.physics)
    data = mujoco.MjData(model)
    robots, (arm, gripper) = len(scene.layout.robots), scene.layout.robots[0]
    works = new_works(robots, len(arm.dof))
    peaks = np.zeros((2, robots, len(arm.dof)))
    gains = np.array([arm.kp, arm.kd])
    command = np.zeros((robots, len(gripper.actuator)))
    fields = _fields(model, scene)
    sim = Sim(
        model=model._address,
        data=data._address,
        state=_segments(
            *(data.qpos, data.qvel, data.qacc_warmstart),
            *(*(work.q0 for work in works), command, *fields),
            *(gains if s.array == GAINS else _view(model, s) for s in scene.varied),
        ),
        slots=_segments(
            *(_view(data, slot) for slot in scene.layout.slots),
            *([peaks] if scene.with_peaks else []),
        ),
        gains=gains,
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
        contacts=data.sensordata,
        peaks=peaks,
    )
    return ThreadData(model, data, sim, works, tuple(fields))


def _fields(model: mujoco.MjModel, scene: Scene) -> list[Array]:
    """Where each model field is set: in the model, or in memory that nothing reads."""
    return [
        np.zeros(visual.size) if physics is None else _view(model, physics)
        for visual, physics in zip(
            scene.layout.fields, scene.physics_fields, strict=True
        )
    ]


def _view(owner: mujoco.MjModel | mujoco.MjData, slot: Slot) -> Array:
    flat: Array = getattr(owner, slot.array).reshape(-1)
    return flat[slot.start : slot.start + slot.size]


def _segments(*runs: Array) -> Segments:
    addresses = [run.ctypes.data for run in runs]
    return Segments(np.array(addresses, np.int64), np.array([run.size for run in runs]))
