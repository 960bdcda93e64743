"""Perturber: changes the actions and observations of N environments in their episodes,
and draws the values of their simulations.

Rewards, success, milestones and the expert do not notice: they use the true state.
"""

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from manip.envs.episode_draws import EpisodeDraws
from manip.envs.episode_streams import Purpose
from manip.envs.option_checks import state_array
from manip.envs.perturbation import Perturbations
from manip.envs.task import Measures, Task
from manip.errors import UserError
from manip.observation import ObservationSpec
from manip.sim.robot_model import reading_prefix

Array = np.ndarray

_READINGS = {
    "hand_position": "eef_pos",
    "joint_position": "joint_pos",
    "joint_velocity": "joint_vel",
}
"""Quantity -> the reading to which it is added."""


class Perturbed(Protocol):
    """The environments that are perturbed; see `TaskBatch`."""

    task: Task
    num_envs: int
    action_dim: int
    observation_spec: ObservationSpec
    seed: int
    purpose: Purpose
    first_env: int
    episode: Array

    def read(self) -> Measures:
        """Readings of all environments."""


class Perturber:
    """Perturb N environments.

    Args:
        perturbations: what differs, and how it is drawn.
        batch: the environments.
    """

    def __init__(self, perturbations: Perturbations, batch: Perturbed) -> None:
        self._batch, self._given = batch, perturbations
        self._sensors, num_envs = batch.task.sensors, batch.num_envs
        bodies = self._sensors.bodies.items()
        self._bodies = [n for n, body in bodies if body not in self._sensors.parked]
        read = batch.read()
        names = (f"{reading_prefix(number)}joint_pos" for number in (0, 1))
        self._robots = sum(name in read for name in names)
        joints = int(read["joint_pos"].shape[1])
        self._draws = [
            EpisodeDraws(each, num_envs, self._size(each.quantity, joints))
            for each in perturbations
        ]
        action_age, age = self._age("action_delay"), self._age("observation_delay")
        self._actions = np.zeros((num_envs, action_age, batch.action_dim))
        dim = batch.observation_spec.dim
        self._observations = np.zeros((num_envs, age, dim), np.float32)

    def begin(self, env_ids: Array) -> None:
        """Draw for the present episodes of some environments."""
        batch = self._batch
        numbers, episodes = batch.first_env + env_ids, batch.episode[env_ids]
        for draws in self._draws:
            draws.begin(env_ids, batch.seed, batch.purpose, numbers, episodes)
        self._actions[env_ids] = 0.0

    def model_values(self, env_ids: Array) -> dict[str, Array]:
        """Quantity -> [n]: values of the simulation in some environments' episodes."""
        start = np.zeros(len(self._actions), int)
        return {
            draws.perturbation.quantity: draws.at(start)[env_ids, 0]
            for draws in self._draws
            if draws.perturbation.kind.of_model
        }

    def act(self, action: Array, elapsed: Array) -> Array:
        """The actions [N, A] that act in step `elapsed` [N] instead of the given."""
        self._actions[:, 1:] = self._actions[:, :-1].copy()
        self._actions[:, 0] = action
        acting = _aged(self._actions, self._sum("action_delay", elapsed))
        return _plus(acting, self._sum("action", elapsed))

    def observe_start(self, env_ids: Array, read: Measures, elapsed: Array) -> None:
        """Begin the observations of some episodes, from readings of all N."""
        self._observations[env_ids] = self._observe(read, elapsed)[env_ids, None]

    def observe_step(self, read: Measures, elapsed: Array) -> None:
        """Add the observations after a step."""
        self._observations[:, 1:] = self._observations[:, :-1].copy()
        self._observations[:, 0] = self._observe(read, elapsed)

    def observation(self, elapsed: Array) -> Array:
        """[N, D]: the observation that the policy gets."""
        return _aged(self._observations, self._sum("observation_delay", elapsed))

    def _observe(self, read: Measures, elapsed: Array) -> Array:
        task = self._batch.task
        parts = task.observe(task.measure(self.measured(read, elapsed)))
        return self._batch.observation_spec.join(parts)

    def measured(self, read: Measures, elapsed: Array) -> dict[str, Array]:
        """Readings [N, ...] as they are measured, with their errors."""
        measured = dict(read)
        for quantity, name in _READINGS.items():
            offset = self._sum(quantity, elapsed)
            if offset is not None:
                for number, own in enumerate(np.split(offset, self._robots, axis=1)):
                    reading = f"{reading_prefix(number)}{name}"
                    measured[reading] = read[reading] + own
        offsets = self._sum("object_position", elapsed)
        for index, name in enumerate((*self._bodies, *self._sensors.sites)):
            columns = slice(3 * index, 3 * index + 3)
            offset = None if offsets is None else offsets[:, columns]
            measured[f"{name}_pos"] = _plus(read[f"{name}_pos"], offset)
        turns = self._sum("object_yaw", elapsed)
        if turns is not None:
            for index, name in enumerate(f"{name}_quat" for name in self._bodies):
                measured[name] = _turned(read[name], turns[:, index])
        return measured

    def save_state(self) -> dict[str, Any]:
        """Delayed actions and observations, and what is perturbed."""
        return {
            "perturbations": [each.to_dict() for each in self._given],
            "delayed_actions": self._actions.copy(),
            "delayed_observations": self._observations.copy(),
        }

    def load_state(self, state: Mapping[str, Any]) -> None:
        """Restore what `save_state` returned, after `begin`.

        Raises:
            UserError: it is of other environments or other perturbations.
        """
        if state.get("perturbations") != [each.to_dict() for each in self._given]:
            raise UserError(
                "the saved state has other perturbations: they must not change in a run"
            )
        self._actions[:] = state_array(state, "delayed_actions", self._actions)
        self._observations[:] = state_array(
            state, "delayed_observations", self._observations
        )

    def _sum(self, quantity: str, elapsed: Array) -> Array | None:
        """[N, k]: sum of what is drawn for a quantity; None if nothing is."""
        values = [
            draws.at(elapsed)
            for draws in self._draws
            if draws.perturbation.quantity == quantity
        ]
        return np.sum(values, axis=0) if values else None

    def _age(self, delay: str) -> int:
        """Number of past values that a delay needs, the present one included."""
        delays = [max(p.values) for p in self._given if p.quantity == delay]
        return 1 + int(np.ceil(sum(delays)))

    def _size(self, quantity: str, joints: int) -> int:
        sizes = {
            "action": self._batch.action_dim,
            "object_position": 3 * (len(self._bodies) + len(self._sensors.sites)),
            "object_yaw": len(self._bodies),
            "hand_position": 3 * self._robots,
            "joint_position": joints * self._robots,
            "joint_velocity": joints * self._robots,
        }
        return sizes.get(quantity, 1)


def _aged(past: Array, delay: Array | None) -> Array:
    """[N, k]: entries of past values [N, L, k], newest first, `delay` [N, 1] steps old.

    Without a delay, the newest.
    """
    rows = np.arange(len(past))
    aged: Array = past[rows, 0 if delay is None else delay[:, 0].astype(int)]
    return aged


def _plus(values: Array, offset: Array | None) -> Array:
    return values if offset is None else values + offset


def _turned(quaternion: Array, angle: Array) -> Array:
    """Rotations [N, 4] wxyz, turned by `angle` [N] rad about the vertical."""
    c, s = np.cos(angle / 2)[:, None], np.sin(angle / 2)[:, None]
    w, x, y, z = np.split(quaternion, 4, axis=1)
    return np.concatenate(
        [c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w], 1
    )
