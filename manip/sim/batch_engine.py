"""BatchEngine: step N environments of one scene in native threads."""

from typing import Self

import numpy as np

from manip.cpus import usable_cpus
from manip.errors import at_least
from manip.sim.row_engine import Buffer, RowEngine
from manip.sim.scene import Scene
from manip.sim.state_row import touch_start
from manip.sim.stepping import Plan, refresh_environments, step_environments
from manip.sim.thread_data import ThreadData
from manip.sim.thread_team import ThreadTeam

Array = np.ndarray


class BatchEngine(RowEngine):
    """Step N environments of a scene with MuJoCo's C code; implements `Engine`.

    Args:
        scene: what is simulated.
        num_envs: N.
        threads: native threads (default: the CPUs that this process may use).
    """

    def __init__(self, scene: Scene, num_envs: int, threads: int | None = None) -> None:
        if threads is not None:
            at_least(1, "threads", threads)
        super().__init__(scene, num_envs, threads or usable_cpus())
        self._plan = _plan(scene)
        self._team = ThreadTeam(scene, self.threads)
        self._refresh(np.arange(num_envs))

    def _advance(self, actions: Array, now: Buffer, after: Buffer) -> None:
        layout, counter = self.scene.layout, np.zeros(1, np.int64)

        def work(thread: ThreadData) -> None:
            step_environments(
                thread.sim,
                self._plan,
                layout.robots,
                thread.works,
                actions,
                now.states,
                now.readings,
                after.states,
                after.readings,
                self.broken,
                counter,
            )

        self._team.run(work, self.num_envs)

    def _refresh(self, env_ids: Array) -> None:
        now, counter = self._now, np.zeros(1, np.int64)

        def work(thread: ThreadData) -> None:
            refresh_environments(
                thread.sim, self._plan, now.states, now.readings, env_ids, counter
            )

        self._team.run(work, len(env_ids))

    def _restored(self, env_ids: Array | slice) -> None:
        """The rows are all that this engine reads."""

    def _another(self) -> Self:
        return type(self)(self.scene, self.num_envs, self.threads)


def _plan(scene: Scene) -> Plan:
    return Plan(
        substeps=scene.substeps,
        touch_start=touch_start(scene),
        touch_of_sensor=scene.touch_of_sensor,
        touch_limit=np.array([touch.limit for touch in scene.layout.touches]),
    )
