"""Engine: the interface of simulations that step N environments of a scene."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

Array = np.ndarray


@dataclass(frozen=True)
class Snapshot:
    """Complete state of n environments: states [n, S] and readings [n, R], float64.

    S, R and the order of the columns are the engine's own.
    """

    states: Array
    readings: Array


@runtime_checkable
class Engine(Protocol):
    """N independent environments of one scene.

    Guarantees of every engine:

    * An environment does not depend on the others, on N, or on the number of threads.
    * A snapshot is complete: restored, at any place of any engine of the same class and
      scene, it replays bit for bit (`WarpEngine` on a GPU: within rounding).
    * Arrays are float64, in SI units and the world frame unless stated.

    Attributes:
        num_envs: N.
        control_dt: control period [s], the time that one step takes.
    """

    num_envs: int
    control_dt: float

    @property
    def before(self) -> Snapshot:
        """The states and readings before the last step; views, valid until the next.

        The snapshot of one environment is `Snapshot(before.states[i], ...)`. Before
        the first step it holds the default state.
        """

    def step(self, action: Array) -> Array:
        """Advance all environments by one control period.

        Args:
            action: [N, A], clipped to [-1, 1].

        Returns:
            [N] bool: environments that became non-finite, or whose action holds NaN.
            They keep the state and readings from before the step.

        Raises:
            UserError: the action has another shape or is not numeric.
        """

    def reset(
        self, env_ids: Array, qpos: Array, fields: Mapping[str, Array] | None = None
    ) -> None:
        """Start new episodes in some environments, as a reset of robosuite does.

        Velocities, warm start, gripper command and memory become 0. The arm's pose in
        `qpos` becomes the null-space target. Fields that are not given take the
        model's values. Readings are refreshed.

        Args:
            env_ids: [n] int, each at most once.
            qpos: [n, nq].
            fields: name -> [n, k], model fields (`Sensors.fields`).

        Raises:
            UserError: a wrong shape, name or index.
        """

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
        """Put some environments into a state in the middle of their episode.

        The warm start becomes 0 and readings are refreshed. Values that are not given
        do not change.

        Args:
            env_ids: [n] int, each at most once.
            qpos: [n, nq].
            qvel: [n, nv].
            start_pos: [n, joints], the null-space target: the arms at the episode's
                start.
            gripper_command: [n, actuators of the grippers] in [-1, 1].
            fields: name -> [n, k], model fields.
            memory: name -> [n, k], the task's numbers (`Sensors.memory`).

        Raises:
            UserError: a wrong shape, name or index, or a value that is not finite.
        """

    def write_memory(self, env_ids: Array, memory: Mapping[str, Array]) -> None:
        """Store numbers of the task with some environments [n]: name -> [n, k]."""

    def read(self) -> dict[str, Array]:
        """Named readings [N, k] of all environments, read-only.

        They may be views that the next call of another method changes: copy what must
        stay. Names are listed at `RowEngine.read`.
        """

    def save(self, env_ids: Array | slice = slice(None)) -> Snapshot:
        """Copy the complete state of some environments."""

    def restore(self, snapshot: Snapshot, env_ids: Array | slice = slice(None)) -> None:
        """Put saved environments back, bit for bit, in the given places."""
