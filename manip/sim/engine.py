"""BatchEngine: N worlds of one scene, stepped by native code on several threads.

One control period of one world is robosuite's own sequence (environments/base.py):
`mj_step1`, goal latched at the first substep, control law, `mj_step2`. As in stock,
positions of bodies and sites, and contacts, are one substep old after a step: they
belong to the state before the last integration.
"""

import itertools
import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, NamedTuple

import mujoco
import numpy as np

from manip.errors import UserError
from manip.sim.compiled import jit, mj_forward, mj_jac_site, mj_step1, mj_step2, mju_copy
from manip.sim.control import (
    NULL_KP,
    joint_torque,
    latch_pose_goal,
    osc_torque,
    pose_error,
)
from manip.sim.model import Arm, Gripper, Scene, Slot, with_joints

Array = np.ndarray

LIMIT = 1e8
"""A world whose |qpos| or |qvel| passes this is counted as broken (MuJoCo: 1e10)."""

CHUNKS_PER_THREAD = 8
"""Worlds are handed out in this many pieces a thread, so slow worlds do not stall."""


class Work(NamedTuple):
    """Scratch of the control law, one a thread."""

    mass: Array
    mass_factor: Array
    jac: Array
    jac_full: Array
    x: Array
    inertia: Array
    linear: Array
    angular: Array
    task: Array
    wrench: Array
    velocity: Array
    pull: Array
    bias: Array
    torque: Array
    goal_p: Array
    goal_r: Array
    turn: Array
    goal_q: Array


class Sim(NamedTuple):
    """A thread's own MjModel and MjData as addresses, and views of their arrays."""

    model: int
    data: int
    qpos: Array
    qvel: Array
    warmstart: Array
    ctrl: Array
    mass: Array
    bias: Array
    site_xpos: Array
    site_xmat: Array
    found: Array
    sources: Array
    targets: Array


class Plan(NamedTuple):
    """Where things lie: in a world's state row, in its readings row."""

    nq: int
    nv: int
    slot_sizes: Array
    field_sizes: Array
    touch_start: int
    touch_of_sensor: Array
    num_touches: int
    substeps: int


@jit
def _load(sim: Sim, plan: Plan, fields_at: int, row: Array) -> None:
    nq, nv = plan.nq, plan.nv
    sim.qpos[:] = row[:nq]
    sim.qvel[:] = row[nq : nq + nv]
    sim.warmstart[:] = row[nq + nv : nq + 2 * nv]
    at = fields_at
    for k in range(len(plan.field_sizes)):
        mju_copy(sim.targets[k], row[at:].ctypes.data, np.int32(plan.field_sizes[k]))
        at += plan.field_sizes[k]


@jit
def _store(sim: Sim, plan: Plan, row: Array) -> None:
    nq, nv = plan.nq, plan.nv
    row[:nq] = sim.qpos
    row[nq : nq + nv] = sim.qvel
    row[nq + nv : nq + 2 * nv] = sim.warmstart


@jit
def _gather(sim: Sim, plan: Plan, row: Array) -> None:
    at = 0
    for k in range(len(plan.slot_sizes)):
        mju_copy(row[at:].ctypes.data, sim.sources[k], np.int32(plan.slot_sizes[k]))
        at += plan.slot_sizes[k]
    row[plan.touch_start :] = 0.0
    for k in range(len(plan.touch_of_sensor)):
        if sim.found[k] > 0.0:
            row[plan.touch_start + plan.touch_of_sensor[k]] = 1.0


@jit
def _broken(sim: Sim) -> bool:
    for x in sim.qpos:
        if not abs(x) < LIMIT:
            return True
    for x in sim.qvel:
        if not abs(x) < LIMIT:
            return True
    return False


@jit
def _latch(sim: Sim, arm: Arm, work: Work, action: Array) -> None:
    if arm.osc:
        latch_pose_goal(action, arm.scale, sim.site_xpos[arm.tool],
                        sim.site_xmat[arm.tool].reshape(3, 3), sim.site_xpos[arm.base],
                        sim.site_xmat[arm.base].reshape(3, 3), work.goal_p, work.goal_r,
                        work.turn)
        return
    for i in range(len(arm.qpos)):
        delta = arm.scale[i] * min(1.0, max(-1.0, action[i]))
        work.goal_q[i] = sim.qpos[arm.qpos[i]] + delta


@jit
def _read_dynamics(sim: Sim, arm: Arm, work: Work) -> None:
    n = len(arm.dof)
    for i in range(n):
        work.bias[i] = sim.bias[arm.dof[i]]
        for j in range(n):
            work.mass[i, j] = sim.mass[arm.mass[i, j]]


@jit
def _jacobian(sim: Sim, arm: Arm, work: Work, site: int) -> None:
    nv = work.jac_full.shape[1]
    start = work.jac_full.ctypes.data
    mj_jac_site(sim.model, sim.data, start, start + 24 * nv, np.int32(site))
    for i in range(6):
        for k in range(len(arm.dof)):
            work.jac[i, k] = work.jac_full[i, arm.dof[k]]


@jit
def _tool_velocity(sim: Sim, arm: Arm, work: Work) -> None:
    """Tool velocity less the linear velocity of the base site, into work.velocity."""
    _jacobian(sim, arm, work, arm.base)
    for i in range(6):
        work.velocity[i] = 0.0
        for k in range(len(arm.dof)):
            if i < 3:
                work.velocity[i] -= work.jac[i, k] * sim.qvel[arm.dof[k]]
    _jacobian(sim, arm, work, arm.tool)
    for i in range(6):
        for k in range(len(arm.dof)):
            work.velocity[i] += work.jac[i, k] * sim.qvel[arm.dof[k]]


@jit
def _arm_torque(sim: Sim, arm: Arm, work: Work, q0: Array) -> None:
    _read_dynamics(sim, arm, work)
    if arm.osc:
        _tool_velocity(sim, arm, work)
        pose_error(arm, sim.site_xpos[arm.tool], sim.site_xmat[arm.tool].reshape(3, 3),
                   sim.site_xpos[arm.base], sim.site_xmat[arm.base].reshape(3, 3),
                   work.goal_p, work.goal_r, work.velocity, work.wrench)
        for i in range(len(arm.dof)):
            work.pull[i] = NULL_KP * (q0[i] - sim.qpos[arm.qpos[i]])
            work.pull[i] -= 2.0 * np.sqrt(NULL_KP) * sim.qvel[arm.dof[i]]
        osc_torque(work.mass, work.jac, work.wrench, work.pull, work.bias, work,
                   work.torque)
        return
    for i in range(len(arm.dof)):
        work.pull[i] = arm.kp * (work.goal_q[i] - sim.qpos[arm.qpos[i]])
        work.pull[i] -= arm.kd * sim.qvel[arm.dof[i]]
    joint_torque(work.mass, work.pull, work.bias, work.torque)


@jit
def _drive_arm(sim: Sim, arm: Arm, work: Work) -> bool:
    """Clip the torque to the actuators' range and apply it; False if not finite."""
    finite = True
    for i in range(len(arm.actuator)):
        torque = work.torque[i]
        finite = finite and np.isfinite(torque)
        sim.ctrl[arm.actuator[i]] = min(arm.high[i], max(arm.low[i], torque))
    return finite


@jit
def _drive_gripper(sim: Sim, gripper: Gripper, action: float, command: Array) -> None:
    for i in range(len(gripper.actuator)):
        moved = command[i] + gripper.speed[i] * np.sign(action)
        command[i] = min(1.0, max(-1.0, moved))
        sim.ctrl[gripper.actuator[i]] = gripper.bias[i] + gripper.weight[i] * command[i]


@jit
def _advance(sim: Sim, plan: Plan, arm: Arm, gripper: Gripper, work: Work,
             action: Array, q0: Array, command: Array) -> bool:
    """One control period of the loaded world; False if it became non-finite."""
    for substep in range(plan.substeps):
        mj_step1(sim.model, sim.data)
        if substep == 0:
            _latch(sim, arm, work, action)
            _drive_gripper(sim, gripper, action[-1], command)
        _arm_torque(sim, arm, work, q0)
        if not _drive_arm(sim, arm, work):
            return False
        mj_step2(sim.model, sim.data)
        if _broken(sim):
            return False
    return True


@jit
def _step_worlds(sim: Sim, plan: Plan, arm: Arm, gripper: Gripper, work: Work,
                 actions: Array, states: Array, readings: Array, broken: Array,
                 start: int, stop: int) -> None:
    """Step worlds [start, stop); a broken one keeps its state and its readings."""
    q0_at = plan.nq + 2 * plan.nv
    command_at = q0_at + len(arm.qpos)
    fields_at = command_at + len(gripper.actuator)
    command = np.empty(len(gripper.actuator))
    for w in range(start, stop):
        row = states[w]
        _load(sim, plan, fields_at, row)
        command[:] = row[command_at:fields_at]
        broken[w] = not _advance(sim, plan, arm, gripper, work, actions[w],
                                 row[q0_at:command_at], command)
        if not broken[w]:
            _store(sim, plan, row)
            row[command_at:fields_at] = command
            _gather(sim, plan, readings[w])


@jit
def _refresh_worlds(sim: Sim, plan: Plan, fields_at: int, states: Array,
                    readings: Array, worlds: Array) -> None:
    """`mj_forward` on the given worlds, as robosuite does at the end of a reset."""
    for w in worlds:
        _load(sim, plan, fields_at, states[w])
        mj_forward(sim.model, sim.data)
        _store(sim, plan, states[w])
        _gather(sim, plan, readings[w])


@dataclass(frozen=True)
class Snapshot:
    """All that some worlds are: states [n, S] and readings [n, R], for `restore`."""

    states: Array
    readings: Array


def usable_cpus() -> int:
    """CPUs this process may run on (its affinity mask where the system has one)."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class BatchEngine:
    """N worlds of a scene.

    A world's state row is [qpos nq, qvel nv, warmstart nv, arm pose at the episode's
    start n, gripper command, model fields]: everything that a step depends on.

    Args:
        scene: what is simulated.
        num_worlds: N.
        threads: native threads; the CPUs this process may use unless given.

    Attributes:
        states: [N, S] float64, the rows described above.
        broken: [N] bool, worlds that became non-finite in the last step; they keep
            the state and readings from before it.
        broken_count: how many worlds have broken so far.
    """

    def __init__(self, scene: Scene, num_worlds: int, threads: int | None = None) -> None:
        if num_worlds < 1:
            raise UserError(f"num_worlds must be at least 1, not {num_worlds}")
        if threads is not None and threads < 1:
            raise UserError(f"threads must be at least 1, not {threads}")
        self.scene = scene
        self.num_worlds = num_worlds
        self.threads = min(threads or usable_cpus(), num_worlds)
        self.control_dt = scene.control_dt
        self._plan = _plan(scene)
        self._fields_at = _fields_at(scene)
        self._mine = [_thread_state(scene) for _ in range(self.threads)]
        self._pool = ThreadPoolExecutor(max(1, self.threads - 1), "manip-sim")
        self.states = np.tile(_default_state(scene), (num_worlds, 1))
        self._readings = np.zeros((num_worlds, _readings_width(scene)))
        self._named = _named_readings(scene, self)
        self.broken = np.zeros(num_worlds, bool)
        self.broken_count = 0
        self._refresh(np.arange(num_worlds))

    def step(self, action: Array) -> None:
        """Advance every world by one control period.

        Args:
            action: [N, A] in [-1, 1] (clipped): the arm's part, then the gripper's,
                positive closing; only the sign of the latter counts.
        """
        action = np.ascontiguousarray(action, dtype=np.float64)
        expected = (self.num_worlds, self.scene.action_dim)
        if action.shape != expected:
            raise UserError(f"action has shape {action.shape}, the engine needs {expected}")
        chunk = -(-self.num_worlds // (self.threads * CHUNKS_PER_THREAD))
        starts = itertools.count(0, chunk)
        others = [
            self._pool.submit(self._work_through, starts, chunk, thread, action)
            for thread in range(1, self.threads)
        ]
        self._work_through(starts, chunk, 0, action)
        for other in others:
            other.result()
        self.broken_count += int(self.broken.sum())

    def write(
        self, worlds: Array, qpos: Array, fields: Mapping[str, Array] | None = None
    ) -> None:
        """Start new episodes in some worlds, as a reset of robosuite does.

        Velocities, warm start and gripper command become zero, the arm's pose in
        `qpos` becomes the null-space target, and readings are refreshed.

        Args:
            worlds: [n] int.
            qpos: [n, nq].
            fields: name -> [n, k], the model fields to set in these worlds.
        """
        scene, plan = self.scene, self._plan
        rows = np.zeros((len(worlds), self.states.shape[1]))
        rows[:, : plan.nq] = qpos
        at = plan.nq + 2 * plan.nv
        rows[:, at : at + len(scene.arm.qpos)] = qpos[:, scene.arm.qpos]
        rows[:, self._fields_at :] = self.states[worlds, self._fields_at :]
        for name, values in (fields or {}).items():
            rows[:, self.field_columns(name)] = values
        self.states[worlds] = rows
        self._refresh(np.asarray(worlds))

    def read(self) -> dict[str, Array]:
        """Named views [N, k] of the readings; see `Sensors` and `robot readings`.

        Always present: qpos, qvel, qacc; joint_pos, joint_vel [N, n]; gripper_qpos,
        gripper_qvel; eef_pos [N, 3] m and eef_mat [N, 9] of the grip site; hand_quat
        [N, 4] wxyz of the hand body; gripper_command, start_pos [N, n]; and one entry
        a field. Views change with the next step: copy what must stay.
        """
        named = dict(self._named)
        for name, columns in _state_columns(self.scene).items():
            named[name] = self.states[:, columns]
        return with_joints(self.scene, named)

    def save(self, worlds: Array | slice = slice(None)) -> Snapshot:
        """Copy everything that the given worlds are."""
        return Snapshot(self.states[worlds].copy(), self._readings[worlds].copy())

    def restore(self, snapshot: Snapshot, worlds: Array | slice = slice(None)) -> None:
        """Put saved worlds back, bit for bit, at the given places."""
        self.states[worlds] = snapshot.states
        self._readings[worlds] = snapshot.readings

    def field_columns(self, name: str) -> slice:
        """Columns of `states` that hold a model field."""
        return _state_columns(self.scene)[name]

    def _work_through(self, starts: Any, chunk: int, thread: int, action: Array) -> None:
        sim, work = self._mine[thread].sim, self._mine[thread].work
        scene = self.scene
        for start in starts:
            if start >= self.num_worlds:
                return
            stop = min(start + chunk, self.num_worlds)
            _step_worlds(sim, self._plan, scene.arm, scene.gripper, work, action,
                         self.states, self._readings, self.broken, start, stop)

    def _refresh(self, worlds: Array) -> None:
        _refresh_worlds(self._mine[0].sim, self._plan, self._fields_at, self.states,
                        self._readings, worlds)


@dataclass(frozen=True)
class _ThreadState:
    """Keeps the MjModel and MjData alive whose memory `sim` points into."""

    model: mujoco.MjModel
    data: mujoco.MjData
    sim: Sim
    work: Work


def _thread_state(scene: Scene) -> _ThreadState:
    model = mujoco.MjModel.__copy__(scene.physics)
    data = mujoco.MjData(model)
    sim = Sim(
        model=model._address,
        data=data._address,
        qpos=data.qpos,
        qvel=data.qvel,
        warmstart=data.qacc_warmstart,
        ctrl=data.ctrl,
        mass=data.M,
        bias=data.qfrc_bias,
        site_xpos=data.site_xpos,
        site_xmat=data.site_xmat,
        found=data.sensordata,
        sources=_addresses(data, scene.slots),
        targets=_addresses(model, scene.fields),
    )
    return _ThreadState(model, data, sim, _work(len(scene.arm.dof), model.nv))


def _addresses(owner: Any, slots: tuple[Slot, ...]) -> Array:
    return np.array(
        [getattr(owner, slot.array).ctypes.data + 8 * slot.start for slot in slots],
        dtype=np.int64,
    )


def _work(n: int, nv: int) -> Work:
    shapes = {
        "mass": (n, n), "mass_factor": (n, n), "jac": (6, n), "jac_full": (6, nv),
        "x": (6, n), "inertia": (6, 6), "linear": (3, 3), "angular": (3, 3),
        "task": (6,), "wrench": (6,), "velocity": (6,), "pull": (n,), "bias": (n,),
        "torque": (n,), "goal_p": (3,), "goal_r": (3, 3), "turn": (3, 3),
        "goal_q": (n,),
    }  # fmt: skip
    return Work(**{name: np.zeros(shape) for name, shape in shapes.items()})


def _plan(scene: Scene) -> Plan:
    touch_of_sensor = np.zeros(scene.physics.nsensor, dtype=np.int64)
    for index, touch in enumerate(scene.touches):
        touch_of_sensor[touch.sensors] = index
    sizes = np.array([slot.size for slot in scene.slots], dtype=np.int64)
    return Plan(
        nq=scene.physics.nq,
        nv=scene.physics.nv,
        slot_sizes=sizes,
        field_sizes=np.array([slot.size for slot in scene.fields], dtype=np.int64),
        touch_start=int(sizes.sum()),
        touch_of_sensor=touch_of_sensor,
        num_touches=len(scene.touches),
        substeps=scene.substeps,
    )


def _fields_at(scene: Scene) -> int:
    model = scene.physics
    return model.nq + 2 * model.nv + len(scene.arm.qpos) + len(scene.gripper.actuator)


def _readings_width(scene: Scene) -> int:
    return sum(slot.size for slot in scene.slots) + len(scene.touches)


def _default_state(scene: Scene) -> Array:
    defaults = [
        getattr(scene.physics, slot.array).ravel()[slot.start : slot.start + slot.size]
        for slot in scene.fields
    ]
    row = np.zeros(_fields_at(scene))
    row[: scene.physics.nq] = scene.qpos
    start = scene.physics.nq + 2 * scene.physics.nv
    row[start : start + len(scene.arm.qpos)] = scene.qpos[scene.arm.qpos]
    return np.concatenate([row, *defaults])


def _named_readings(scene: Scene, engine: BatchEngine) -> dict[str, Array]:
    named, at = {}, 0
    for slot in scene.slots:
        named[slot.name] = engine._readings[:, at : at + slot.size]
        at += slot.size
    for index, touch in enumerate(scene.touches):
        named[touch.name] = engine._readings[:, at + index]
    return named


def _state_columns(scene: Scene) -> dict[str, slice]:
    start = scene.physics.nq + 2 * scene.physics.nv
    command = start + len(scene.arm.qpos)
    at = command + len(scene.gripper.actuator)
    columns = {"start_pos": slice(start, command), "gripper_command": slice(command, at)}
    for slot in scene.fields:
        columns[slot.name] = slice(at, at + slot.size)
        at += slot.size
    return columns

