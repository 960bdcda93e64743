"""BatchEngine: N worlds of one scene, stepped by native code on several threads.

One control period of one world is robosuite's own sequence (environments/base.py):
`mj_step1`, goal latched at the first substep, control law, `mj_step2`. As in stock,
positions of bodies and sites, and contacts, are one substep old after a step: they
belong to the state before the last integration.
"""

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import mujoco
import numpy as np

from manip.cpus import usable_cpus
from manip.errors import UserError
from manip.sim.scene import Scene
from manip.sim.scene_layout import with_joints
from manip.sim.stepping import Plan, refresh_worlds, step_worlds
from manip.sim.thread_data import ThreadData, thread_data

Array = np.ndarray


@dataclass(frozen=True)
class Snapshot:
    """All that some worlds are: states [n, S] and readings [n, R], for `restore`."""

    states: Array
    readings: Array


class BatchEngine:
    """N worlds of a scene.

    A world's state row is [qpos nq, qvel nv, warmstart nv, arm pose at the episode's
    start n, gripper command, model fields, the task's memory]: everything that a step
    depends on.

    Args:
        scene: what is simulated.
        num_envs: N.
        threads: native threads; the CPUs this process may use unless given.

    Attributes:
        states: [N, S] float64, the rows described above.
        broken: [N] bool, worlds that became non-finite in the last step, or whose
            action was NaN; they keep the state and readings from before it.
        broken_count: how many worlds have broken so far.
    """

    def __init__(self, scene: Scene, num_envs: int, threads: int | None = None) -> None:
        if num_envs < 1:
            raise UserError(f"num_envs must be at least 1, not {num_envs}")
        if threads is not None and threads < 1:
            raise UserError(f"threads must be at least 1, not {threads}")
        self.scene = scene
        self.num_envs = num_envs
        self.threads = min(threads or usable_cpus(), num_envs)
        self.control_dt = scene.control_dt
        self._plan = _plan(scene)
        self._fields_at = _fields_at(scene)
        self._memory_at = self._fields_at + sum(s.size for s in scene.layout.fields)
        self._mine = [thread_data(scene) for _ in range(self.threads)]
        self._pool = ThreadPoolExecutor(max(1, self.threads - 1), "manip-sim")
        self.states = np.tile(_default_state(scene), (num_envs, 1))
        self._readings = np.zeros((num_envs, _readings_width(scene)))
        self._named = _named_readings(scene, self)
        self.broken = np.zeros(num_envs, bool)
        self.broken_count = 0
        self._refresh(np.arange(num_envs))

    def step(self, action: Array) -> Array:
        """Advance every world by one control period.

        Args:
            action: [N, A] in [-1, 1] (clipped): the arm's part, then the gripper's,
                positive closing; only the sign of the latter counts.

        Returns:
            [N] bool, the `broken` environments.
        """
        action = np.ascontiguousarray(action, dtype=np.float64)
        expected = (self.num_envs, self.scene.layout.action_dim)
        if action.shape != expected:
            raise UserError(
                f"action has shape {action.shape}, the engine needs {expected}"
            )
        arm, gripper = self.scene.layout.arm, self.scene.layout.gripper
        counter = np.zeros(1, np.int64)

        def work(mine: ThreadData) -> None:
            step_worlds(
                mine.sim,
                self._plan,
                arm,
                gripper,
                mine.work,
                action,
                self.states,
                self._readings,
                self.broken,
                counter,
            )

        self._share(work, self.num_envs)
        self.broken_count += int(self.broken.sum())
        return self.broken

    def reset(
        self, worlds: Array, qpos: Array, fields: Mapping[str, Array] | None = None
    ) -> None:
        """Start new episodes in some worlds, as a reset of robosuite does.

        Velocities, warm start, gripper command and memory become zero, the arm's pose
        in `qpos` becomes the null-space target, and readings are refreshed.

        Args:
            worlds: [n] int.
            qpos: [n, nq].
            fields: name -> [n, k], the model fields to set in these worlds.
        """
        rows = np.zeros((len(worlds), self.states.shape[1]))
        rows[:, : qpos.shape[1]] = qpos
        start_pos = self.field_columns("start_pos")
        rows[:, start_pos] = qpos[:, self.scene.layout.arm.qpos]
        kept = slice(self._fields_at, self._memory_at)
        rows[:, kept] = self.states[worlds, kept]
        for name, values in (fields or {}).items():
            rows[:, self.field_columns(name)] = values
        self.states[worlds] = rows
        self._refresh(np.asarray(worlds))

    def write_memory(self, worlds: Array, memory: Mapping[str, Array]) -> None:
        """Keep numbers of the task's, name -> [n, k], with some worlds [n] int."""
        for name, values in memory.items():
            self.states[worlds, self.field_columns(name)] = values

    def read(self) -> dict[str, Array]:
        """Named views [N, k] of the readings.

        Always present: qpos, qvel, qacc; joint_pos, joint_vel [N, n]; gripper_qpos,
        gripper_qvel; eef_pos [N, 3] m and eef_mat [N, 9] of the grip site; hand_quat
        [N, 4] wxyz of the hand body; gripper_command, one number an actuator;
        gripper_closing [N], 1 when told to close; gripper_speed [1], how much that
        changes in a step; gripper_narrowest [1] m between pads when shut; start_pos
        [N, n], the arm at the episode's start; rest_pos [1, n], its default pose;
        joint_low, joint_high [1, n], its limits; what the task's `Sensors` name, fields
        and memory too.
        Views change with the next step: copy what must stay.
        """
        named = dict(self._named)
        for name, columns in _state_columns(self.scene).items():
            named[name] = self.states[:, columns]
        return with_joints(self.scene.layout, named)

    def save(self, worlds: Array | slice = slice(None)) -> Snapshot:
        """Copy everything that the given worlds are."""
        return Snapshot(self.states[worlds].copy(), self._readings[worlds].copy())

    def restore(self, snapshot: Snapshot, worlds: Array | slice = slice(None)) -> None:
        """Put saved worlds back, bit for bit, at the given places."""
        self.states[worlds] = snapshot.states
        self._readings[worlds] = snapshot.readings

    @property
    def bytes_per_world(self) -> int:
        """Memory that one more world takes: its state and its readings."""
        return int(self.states[0].nbytes + self._readings[0].nbytes)

    def field_columns(self, name: str) -> slice:
        """Columns of `states` that hold a model field or a part of the memory."""
        return _state_columns(self.scene)[name]

    def visual_model(self, state: Array) -> mujoco.MjModel:
        """A copy of the stock model with the model fields of a state row [S]."""
        model = mujoco.MjModel.__copy__(self.scene.visual)
        for slot in self.scene.layout.fields:
            flat = getattr(model, slot.array).reshape(-1)
            values = state[self.field_columns(slot.name)]
            flat[slot.start : slot.start + slot.size] = values
        return model

    def _refresh(self, worlds: Array) -> None:
        counter = np.zeros(1, np.int64)

        def work(mine: ThreadData) -> None:
            refresh_worlds(
                mine.sim, self._plan, self.states, self._readings, worlds, counter
            )

        self._share(work, len(worlds))

    def _share(self, work: Callable[[ThreadData], None], worlds: int) -> None:
        """Run `work` on as many threads as there are worlds for."""
        first, *rest = self._mine[: max(1, min(self.threads, worlds))]
        others = [self._pool.submit(work, mine) for mine in rest]
        work(first)
        for other in others:
            other.result()


def _plan(scene: Scene) -> Plan:
    return Plan(
        substeps=scene.substeps,
        touch_at=sum(slot.size for slot in scene.layout.slots),
        touch_of_sensor=scene.touch_of_sensor,
        most=np.array([touch.most for touch in scene.layout.touches]),
    )


def _fields_at(scene: Scene) -> int:
    model = scene.physics
    return (
        model.nq
        + 2 * model.nv
        + len(scene.layout.arm.qpos)
        + len(scene.layout.gripper.actuator)
    )


def _readings_width(scene: Scene) -> int:
    return sum(slot.size for slot in scene.layout.slots) + len(scene.layout.touches)


def _default_state(scene: Scene) -> Array:
    defaults = [
        getattr(scene.physics, slot.array).ravel()[slot.start : slot.start + slot.size]
        for slot in scene.layout.fields
    ]
    row = np.zeros(_fields_at(scene))
    row[: scene.physics.nq] = scene.layout.qpos
    start = scene.physics.nq + 2 * scene.physics.nv
    row[start : start + len(scene.layout.arm.qpos)] = scene.layout.qpos[
        scene.layout.arm.qpos
    ]
    return np.concatenate([row, *defaults, np.zeros(sum(scene.layout.memory.values()))])


def _named_readings(scene: Scene, engine: BatchEngine) -> dict[str, Array]:
    named, at = {}, 0
    for slot in scene.layout.slots:
        named[slot.name] = engine._readings[:, at : at + slot.size]
        at += slot.size
    for index, touch in enumerate(scene.layout.touches):
        named[touch.name] = engine._readings[:, at + index]
    return named


def _state_columns(scene: Scene) -> dict[str, slice]:
    start = scene.physics.nq + 2 * scene.physics.nv
    command = start + len(scene.layout.arm.qpos)
    at = command + len(scene.layout.gripper.actuator)
    columns = {
        "start_pos": slice(start, command),
        "gripper_command": slice(command, at),
    }
    fields = {slot.name: slot.size for slot in scene.layout.fields}
    for name, size in (*fields.items(), *scene.layout.memory.items()):
        columns[name] = slice(at, at + size)
        at += size
    return columns
