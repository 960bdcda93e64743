"""Visible measures: named numbers of a task that a person can see in a film.

People and simulated labellers compare behaviours by them, and a reward model of
preferences can use them as its inputs (see `manip.preferences`).
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from manip.arrays import all_on_host, on_host
from manip.envs.hand_motion import HandMotion
from manip.envs.option_checks import state_array
from manip.envs.task import Measures, Task
from manip.envs.task_check import check_visible_measures

Array = np.ndarray


class VisibleMeasures:
    """The visible measures of N environments, and the motion that they need.

    Args:
        task: the task.
        num_envs: N.
        measure: returns the task's measures of the present state.
        control_dt: control period [s].

    Raises:
        UserError: `Task.visible_measures` returns something else than numbers [N].

    Attributes:
        names: of the measures, in order.
    """

    def __init__(
        self,
        task: Task,
        num_envs: int,
        measure: Callable[[], Measures],
        control_dt: float,
    ) -> None:
        self._task, self._measure = task, measure
        self._motion = HandMotion(num_envs, control_dt)
        self.names = check_visible_measures(task, self._all(), num_envs)

    def get(self) -> Array:
        """[N, M] float32: the present values; 0 where one is not finite."""
        named = self._task.visible_measures(self._all())
        num_envs = len(self._motion.rows)
        columns = [named[name] for name in self.names]
        values = np.stack(columns, axis=1) if columns else np.zeros((num_envs, 0))
        return np.nan_to_num(values, posinf=0.0, neginf=0.0).astype(np.float32)

    def begin(self, env_ids: Array) -> None:
        """Put the hands to rest where they are, in environments that restarted."""
        self._motion.begin(env_ids, self._position()[env_ids])

    def step(self) -> None:
        """Continue the motion after a control step."""
        self._motion.step(self._position())

    def save_state(self) -> Array:
        """[N, 3, 3]: what the next values depend on besides the present state."""
        return self._motion.rows.copy()

    def load_state(self, state: Mapping[str, Any]) -> None:
        """Restore `motion` of a batch's saved state; without it hands are at rest.

        Raises:
            UserError: it is of other environments.
        """
        rows = self._motion.rows
        rows[:] = [np.full(3, np.nan), np.zeros(3), np.zeros(3)]
        if "motion" in state:
            rows[:] = state_array(state, "motion", rows)

    def _all(self) -> dict[str, Array]:
        return {**all_on_host(self._measure()), **self._motion.readings()}

    def _position(self) -> Array:
        """[N, 3] m: the hand; 0 where the task's simulation does not give it."""
        still = np.zeros((len(self._motion.rows), 3))
        return np.asarray(on_host(self._measure().get(self._task.hand_reading, still)))
