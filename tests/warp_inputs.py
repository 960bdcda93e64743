"""The same inputs for a control law in C and on Warp."""

from typing import Any

import mujoco
import numpy as np
import warp as wp

from manip.compiled import jit
from manip.sim.control_step import control
from manip.sim.scene import Scene
from manip.sim.thread_data import ThreadData, thread_data
from manip.sim.warp.controller import Controller
from manip.sim.warp.device_model import device_data, host_model
from manip.sim.warp.sizes import Sizes

Array = np.ndarray

ARRAYS = ("qpos", "qvel", "qfrc_bias", "cdof", "subtree_com", "site_xpos", "site_xmat")


@jit
def _control(sim: Any, robots: Any, works: Any, action: Array) -> None:
    control(sim, robots, works, action, 0)


def torques(scene: Scene, num_envs: int = 16) -> tuple[Array, Array, Array]:
    """Controls [N, nu] of C and of Warp, and C's torques [N, n] before the clip."""
    thread = thread_data(scene)
    data = device_data(host_model(scene), num_envs, Sizes(96, 64))
    controller = Controller(scene, data)
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1.2, 1.2, (num_envs, scene.layout.action_dim))
    actions = actions.astype(np.float32)
    given: dict[str, list[Array]] = {name: [] for name in (*ARRAYS, "qM", "q0")}
    ours, unclipped = [], []
    for action in actions:
        _pose(thread, scene, rng, given)
        robots = scene.layout.robots
        _control(thread.sim, robots, thread.works, action.astype(float))
        ours.append(thread.data.ctrl.copy())
        unclipped.append(thread.works[0].torque.copy())
    _send(given, data, controller)
    controller.latch(wp.array(actions, dtype=float))
    controller.drive()
    return np.array(ours), data.ctrl.numpy(), np.array(unclipped)


def _pose(
    thread: ThreadData, scene: Scene, rng: Any, given: dict[str, list[Array]]
) -> None:
    """Put the arm into a random pose; round what the law reads to float32."""
    data, arm = thread.data, scene.layout.robots[0].arm
    n, work = len(arm.dof), thread.works[0]
    thread.sim.command[:] = 0
    data.qpos[:] = scene.layout.qpos
    data.qpos[arm.qpos] += rng.normal(0, 0.3, n)
    data.qvel[arm.dof] = rng.normal(0, 0.5, n)
    mujoco.mj_step1(thread.model, data)
    for name in (*ARRAYS, "M"):
        values = getattr(data, name)
        values[...] = values.astype(np.float32)
    work.q0[:] = (data.qpos[arm.qpos] + 0.1).astype(np.float32)
    for name in ARRAYS:
        given[name].append(getattr(data, name).copy())
    given["q0"].append(work.q0.copy())
    given["qM"].append(_dense(thread.model, data.M))


def _dense(model: mujoco.MjModel, sparse: Array) -> Array:
    full = np.zeros((model.nv, model.nv))
    for row in range(model.nv):
        start = model.M_rowadr[row]
        entries = np.arange(start, start + model.M_rownnz[row])
        columns = model.M_colind[entries]
        full[row, columns] = full[columns, row] = sparse[entries]
    return full


def _send(given: dict[str, list[Array]], data: Any, controller: Controller) -> None:
    for name in ARRAYS:
        target = getattr(data, name)
        target.assign(np.array(given[name]).reshape(target.numpy().shape))
    mass = np.zeros(data.qM.numpy().shape)
    nv = given["qM"][0].shape[0]
    mass[:, :nv, :nv] = given["qM"]
    data.qM.assign(mass)
    controller.state.q0.assign(np.array(given["q0"]))
