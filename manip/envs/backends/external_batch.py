"""ExternalBatch: N environments of another library, stepped in worker processes."""

from functools import partial
from typing import Any

import numpy as np

from manip.cameras import CameraConfig, check_cameras
from manip.cpus import usable_cpus
from manip.envs.backends.worker_pool import WorkerPool
from manip.envs.episode_options import EpisodeOptions
from manip.envs.episode_streams import build_seed, episode_seed
from manip.envs.external_task import EARNED, ExternalTask
from manip.envs.option_checks import check_flag
from manip.envs.task import Measures
from manip.envs.task_batch import TaskBatch
from manip.envs.task_errors import exits_blamed
from manip.errors import UserError, at_least
from manip.robot_config import RobotConfig
from manip.sim.external.external_sim import ExternalSim, ExternalStep
from manip.sim.not_copied import NotCopied
from manip.sim.robosuite_factory import PANDA

Array = np.ndarray


class ExternalBatch(NotCopied, TaskBatch):
    """Step N environments of another library, in one process per thread.

    The saved state is the list of actions since each episode began; restoring it
    repeats them.

    Args:
        task: the task.
        num_envs: N.
        robot: the arms, their controller and control frequency.
        fidelity, restart_fraction: "exact" and 0; nothing else is possible.
        threads: processes; the CPUs this process may use by default.
        stagger: begin the first episodes at different times, so that they do not all
            end at the same step.
        hard_reset: rebuild robosuite's model at every reset.
        options: as in `EpisodeOptions`; reward is "stock".

    Raises:
        UserError: the library has no such arm, action space, fidelity or reward.
    """

    task: ExternalTask

    def __init__(
        self,
        task: ExternalTask,
        num_envs: int,
        *,
        robot: RobotConfig = PANDA,
        fidelity: str = "exact",
        threads: int | None = None,
        stagger: bool = False,
        restart_fraction: float = 0.0,
        hard_reset: bool = False,
        **options: Any,
    ) -> None:
        if (fidelity, restart_fraction) != ("exact", 0):
            raise UserError(
                f"{task.name} has its library's own physics and starts: it needs "
                f"fidelity exact and restart_fraction 0, not {fidelity} and "
                f"{restart_fraction}"
            )
        at_least(1, "num_envs", num_envs)
        check_flag("stagger", stagger)
        check_flag("hard_reset", hard_reset)
        at_least(1, "threads", 1 if threads is None else threads)
        task.module().check_robot_config(robot)
        processes = min(threads or usable_cpus(), num_envs)
        episodes = EpisodeOptions(**({"reward": "stock"} | options))
        episodes.refuse_looks(task.library)
        episodes.refuse_perturbations(task.library)
        cameras = check_cameras(episodes.cameras)
        make = partial(_open, task, robot, hard_reset, cameras, episodes)
        with exits_blamed(task):
            self._pool = WorkerPool(make, num_envs, processes)
            first: ExternalStep = self._pool.call("start", {0: (0,)})[0]
            action_dim: int = self._pool.call("action_dim", {0: ()})[0]
        self._steps = [first] * num_envs
        self._actions: list[list[Array]] = [[] for _ in range(num_envs)]
        self._stagger = stagger
        self._changes = 0
        super().__init__(task, num_envs, action_dim, episodes, robot.control_freq)

    def read(self) -> Measures:
        """The parts of the observation [N, k]; reward, success and terminated [N]."""
        steps = self._steps
        parts = {n: np.stack([s.parts[n] for s in steps]) for n in steps[0].parts}
        return parts | {n: np.array([getattr(s, n) for s in steps]) for n in EARNED}

    def _version(self) -> object:
        return self._changes

    def visual_model(self, env_id: int) -> Any:
        """Not possible: the model is in another library or process."""
        raise UserError(
            f"{self.task.name} is stepped by {self.task.library} and cannot be rendered"
        )

    def _draw(self, env_ids: Array) -> Measures:
        """The images of the latest steps."""
        steps = [self._steps[env_id] for env_id in env_ids]
        names = [part.name for part in self.cameras.parts]
        return {name: np.stack([s.images[name] for s in steps]) for name in names}

    def episode_seed(self, env_id: int) -> int:
        """The seed of an environment's present episode, below 2^32."""
        number = self.first_env + env_id
        key = self.seed, self.purpose, number, int(self.episode[env_id])
        return int(episode_seed(*key).generate_state(1)[0])

    def _start_episodes(self, env_ids: Array) -> None:
        self._changes += 1
        seeds = {env_id: (self.episode_seed(env_id),) for env_id in map(int, env_ids)}
        for env_id, step in self._pool.call("start", seeds).items():
            self._steps[env_id], self._actions[env_id] = step, []
            if self._stagger and self.episode[env_id] == 0:
                self.elapsed[env_id] = self.horizon * env_id // self.num_envs

    def _keep(self, env_ids: Array, memory: Measures) -> None:
        """External tasks have no memory."""

    def _move(self, action: Array) -> Array:
        self._changes += 1
        diverged = np.isnan(action).any(axis=1)
        calls = {int(env_id): (action[env_id],) for env_id in np.flatnonzero(~diverged)}
        for env_id, step in self._pool.call("step", calls).items():
            self._actions[env_id].append(action[env_id].copy())
            diverged[env_id] = step is None
            self._steps[env_id] = step or self._steps[env_id]
        return diverged

    def save_state(self) -> dict[str, Any]:
        """Clocks, episode numbers, and the actions of the present episodes."""
        empty = np.zeros((0, self.action_dim), np.float32)
        actions = [np.array(taken or empty) for taken in self._actions]
        return {**self._clocks(), "actions": actions}

    def load_state(self, state: dict[str, Any]) -> None:
        """Restore what `save_state` returned by repeating the actions.

        Raises:
            UserError: the state is of other environments.
        """
        actions = [self._checked(taken) for taken in state["actions"]]
        if len(actions) != self.num_envs:
            raise UserError(
                f"the saved state is of {len(actions)} environments, "
                f"not {self.num_envs}"
            )
        self._restore_clocks(state)
        self._changes += 1
        self._actions = [list(taken) for taken in actions]
        calls = {
            env_id: (self.episode_seed(env_id), taken)
            for env_id, taken in enumerate(actions)
        }
        results = self._pool.call("repeat", calls)
        if diverged := [env_id for env_id, step in results.items() if step is None]:
            raise UserError(
                f"the saved actions of environment {diverged[0]} end in divergence"
            )
        self._steps = [results[env_id] for env_id in range(self.num_envs)]

    def _checked(self, actions: Any) -> Array:
        taken = np.asarray(actions)
        if taken.ndim != 2 or taken.shape[1] != self.action_dim:
            raise UserError(
                f"actions of the saved state have shape {taken.shape}, not "
                f"(steps, {self.action_dim})"
            )
        if not np.isfinite(taken).all():
            raise UserError("actions of the saved state are not finite")
        return taken


def _open(
    task: ExternalTask,
    robot: RobotConfig,
    hard_reset: bool,
    cameras: CameraConfig,
    episodes: EpisodeOptions,
    env_id: int,
) -> ExternalSim:
    """Build the simulation of an environment; what it samples now has its own seed."""
    number = episodes.first_env + env_id
    seed = build_seed(episodes.seed, episodes.purpose, number)
    opened: ExternalSim = task.module().open_sim(
        task.environment, robot, seed, hard_reset, cameras
    )
    return opened
