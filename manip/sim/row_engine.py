"""RowEngine: an engine whose environments are rows of numbers.

One control period of one environment is robosuite's own sequence
(environments/base.py): step1, goal latched at the first substep, control law, step2.
As in robosuite, positions of bodies and sites, and contacts, are one substep old after
a step: they are those before the last integration.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, NamedTuple, Self

import mujoco
import numpy as np

from manip.errors import UserError, at_least, check_choice
from manip.sim.actions import checked_actions
from manip.sim.engine import Snapshot
from manip.sim.env_ids import checked_env_ids
from manip.sim.exclusive_use import ExclusiveUse
from manip.sim.fields import write_slot
from manip.sim.not_copied import NotCopied
from manip.sim.read_only import read_only
from manip.sim.scene import Scene
from manip.sim.scene_layout import constant_readings, with_joints
from manip.sim.scene_variation import draw_sizes
from manip.sim.state_row import (
    default_row,
    reading_columns,
    readings_width,
    state_columns,
)

Array = np.ndarray

_NOT_READ = {"qpos", "qvel", "warmstart"}
"""Parts of a state row that `read` takes from the readings, or leaves out."""


class Buffer(NamedTuple):
    """States [N, S] and readings [N, R] of one instant, and read-only views."""

    states: Array
    readings: Array
    views: Mapping[str, Array]


class RowEngine(NotCopied, ABC):
    """Base class of the engines that step environments of a scene; see `Engine`.

    An environment's state row holds everything that a step depends on; see
    `manip.sim.state_row.state_columns`. Only one thread may use an engine at a time. A
    deep copy is a separate engine; pickling raises UserError.

    Args:
        scene: what is simulated.
        num_envs: N.
        threads: native threads for the simulation and for images.

    Attributes:
        broken: [N] bool, environments that broke in the last step.
        broken_count: number of environments that have broken so far.
        changes: number of calls so far that have changed a state.
    """

    def __init__(self, scene: Scene, num_envs: int, threads: int) -> None:
        at_least(1, "num_envs", num_envs)
        at_least(1, "threads", threads)
        self.scene = scene
        self.num_envs = num_envs
        self.threads = min(threads, num_envs)
        self.control_dt = scene.control_dt
        self.broken = np.zeros(num_envs, bool)
        self.broken_count = 0
        self.changes = 0
        self._columns = state_columns(scene)
        self._default = default_row(scene)
        self._constants = read_only(constant_readings(scene.layout))
        self._exclusive = ExclusiveUse("the engine")
        self._now, self._before = (self._new_buffer() for _ in range(2))

    @abstractmethod
    def _advance(self, actions: Array, now: Buffer, after: Buffer) -> None:
        """Take one control period from the rows `now` to the rows `after`.

        It sets `self.broken`; rows of broken environments are copied unchanged.
        """

    @abstractmethod
    def _refresh(self, env_ids: Array) -> None:
        """Run `mj_forward` on rows that were set, as at the end of robosuite's reset.

        It sets their warm starts and readings.
        """

    @abstractmethod
    def _restored(self, env_ids: Array | slice) -> None:
        """Called after saved rows were put back, which need no `mj_forward`."""

    def _fetch(self) -> None:
        """Called before present rows are read; an engine on a device copies them."""

    @abstractmethod
    def _another(self) -> Self:
        """Build an engine with the same options."""

    @property
    def states(self) -> Array:
        """[N, S] float64: the present state rows, which the next step changes."""
        self._fetch()
        return self._now.states

    @property
    def before(self) -> Snapshot:
        """As `Engine.before`: a step writes into the other one of two buffers."""
        return Snapshot(self._before.states, self._before.readings)

    def step(self, action: Array) -> Array:
        """As `Engine.step`; the action is the arm's part, then the gripper's number.

        The gripper closes while its number is positive: only the sign counts. The
        numbers of a second robot follow.
        """
        actions = self._checked(action)
        with self._exclusive:
            self._advance(actions, self._now, self._before)
            self._now, self._before = self._before, self._now
            self.changes += 1
            self.broken_count += int(self.broken.sum())
        return self.broken

    def reset(
        self, env_ids: Array, qpos: Array, fields: Mapping[str, Array] | None = None
    ) -> None:
        """As `Engine.reset`."""
        env_ids = checked_env_ids(env_ids, self.num_envs)
        rows = np.tile(self._default, (len(env_ids), 1))
        self._fill(rows, "qpos", qpos)
        start_pos = rows[:, self._columns["qpos"]][:, self.scene.layout.joint_qpos]
        rows[:, self._columns["start_pos"]] = start_pos
        self._fill_fields(rows, fields)
        self._write(env_ids, rows)

    def set_state(
        self,
        env_ids: Array,
        qpos: Array,
        qvel: Array,
        *,
        start_pos: Array | None = None,
        gripper_command: Array | None = None,
        fields: Mapping[str, Array] | None = None,
        memory: Mapping[str, Array] | None = None,
    ) -> None:
        """As `Engine.set_state`."""
        env_ids = checked_env_ids(env_ids, self.num_envs)
        rows = self.states[env_ids]
        self._fill(rows, "qpos", qpos)
        self._fill(rows, "qvel", qvel)
        if start_pos is not None:
            self._fill(rows, "start_pos", start_pos)
        if gripper_command is not None:
            self._fill(rows, "gripper_command", gripper_command)
        self._fill_fields(rows, fields)
        for name, values in (memory or {}).items():
            check_choice("memory", name, self.scene.layout.memory)
            self._fill(rows, name, values)
        rows[:, self._columns["warmstart"]] = 0.0
        if not np.isfinite(rows).all():
            raise UserError("the state to set holds values that are not finite")
        self._write(env_ids, rows)

    def write_memory(self, env_ids: Array, memory: Mapping[str, Array]) -> None:
        """As `Engine.write_memory`."""
        env_ids = checked_env_ids(env_ids, self.num_envs)
        with self._exclusive:
            self.changes += 1
            for name, values in memory.items():
                check_choice("memory", name, self.scene.layout.memory)
                columns = self._columns[name]
                _check_shape(name, values, (len(env_ids), columns.stop - columns.start))
                self._now.states[env_ids, columns] = values

    def read(self) -> dict[str, Array]:
        """Named readings [N, k], read-only views; a step changes them.

        Always present: qpos, qvel, qacc; joint_pos, joint_vel [N, n]; gripper_qpos,
        gripper_qvel; eef_pos [N, 3] m and eef_mat [N, 9] of the grip site; hand_quat
        [N, 4] wxyz of the hand body; gripper_closing [N], 1 once it is commanded to
        close fully; rest_pos [1, n], the arm's default pose; joint_low, joint_high
        [1, n], its limits, both 0 for a joint without. Those of a second robot follow,
        as robot1_joint_pos etc.

        Once for all robots: gripper_command, one number an actuator; start_pos, the
        arms at the episode's start; gripper_speed [1], how much gripper_closing changes
        in a step; gripper_narrowest and gripper_widest [1] m between the pads when
        shut and open (see `SceneLayout`); and everything that the task's `Sensors`
        name, fields and memory included.
        """
        with self._exclusive:
            self._fetch()
            named = {**self._now.views, **self._constants}
            return read_only(with_joints(self.scene.layout, named))

    def save(self, env_ids: Array | slice = slice(None)) -> Snapshot:
        """As `Engine.save`."""
        with self._exclusive:
            self._fetch()
            now = self._now
            return Snapshot(now.states[env_ids].copy(), now.readings[env_ids].copy())

    def restore(self, snapshot: Snapshot, env_ids: Array | slice = slice(None)) -> None:
        """As `Engine.restore`."""
        with self._exclusive:
            self.changes += 1
            self._now.states[env_ids] = snapshot.states
            self._now.readings[env_ids] = snapshot.readings
            self._restored(env_ids)

    def state_columns(self, name: str) -> slice:
        """Columns of `states` that hold a part of the state, a field or memory."""
        return self._columns[name]

    @property
    def bytes_per_env(self) -> int:
        """Memory that one more environment takes: states and readings, twice."""
        return 2 * int(self.states[0].nbytes + self._now.readings[0].nbytes)

    def visual_model(self, state: Array) -> mujoco.MjModel:
        """Copy the stock model, with the model fields of a state row [S]."""
        model = mujoco.MjModel.__copy__(self.scene.visual)
        for slot in self.scene.layout.fields:
            write_slot(model, slot, state[self._columns[slot.name]])
        varied = {s.name: state[self._columns[s.name]] for s in self.scene.varied}
        draw_sizes(self.scene, model, varied)
        return model

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """Build another engine in the same state; both share the scene."""
        copy = self._another()
        copy.restore(self.save())
        copy._before.states[:] = self.before.states
        copy._before.readings[:] = self.before.readings
        copy.broken[:], copy.broken_count = self.broken, self.broken_count
        copy.changes = self.changes
        return copy

    def _checked(self, action: Array) -> Array:
        """The action as `_advance` takes it; see `checked_actions`."""
        action_dim = self.scene.layout.action_dim
        return checked_actions(action, self.num_envs, action_dim)

    def _new_buffer(self) -> Buffer:
        states = np.tile(self._default, (self.num_envs, 1))
        readings = np.zeros((self.num_envs, readings_width(self.scene)))
        views = {
            name: readings[:, columns]
            for name, columns in reading_columns(self.scene).items()
        }
        for name, columns in self._columns.items():
            if name not in _NOT_READ:
                views[name] = states[:, columns]
        return Buffer(states, readings, read_only(views))

    def _write(self, env_ids: Array, rows: Array) -> None:
        """Set state rows and refresh their readings."""
        with self._exclusive:
            self.changes += 1
            self._now.states[env_ids] = rows
            self._refresh(env_ids)

    def _fill_fields(self, rows: Array, fields: Mapping[str, Array] | None) -> None:
        known = [s.name for s in (*self.scene.layout.fields, *self.scene.varied)]
        for name, values in (fields or {}).items():
            check_choice("model field", name, known)
            self._fill(rows, name, values)

    def _fill(self, rows: Array, name: str, values: Array) -> None:
        """Write a part of some state rows, of the right shape [n, k]."""
        part = rows[:, self._columns[name]]
        _check_shape(name, values, part.shape)
        part[:] = values


def _check_shape(name: str, values: Array, expected: tuple[int, ...]) -> None:
    if np.shape(values) != expected:
        raise UserError(f"{name} has shape {np.shape(values)}, expected {expected}")
