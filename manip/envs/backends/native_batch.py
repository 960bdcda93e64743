"""NativeBatch: N environments of a task on the batch engine."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np

from manip.arrays import on_host
from manip.cameras import check_cameras
from manip.envs.episode_looks import EpisodeLooks
from manip.envs.episode_options import EpisodeOptions
from manip.envs.episode_streams import EpisodeStreams
from manip.envs.external_task import ExternalTask
from manip.envs.faults import Fault
from manip.envs.option_checks import check_flag, check_share, state_array
from manip.envs.restart_buffer import INTERVAL, RestartBuffer
from manip.envs.task import Measures, Task
from manip.envs.task_batch import TaskBatch
from manip.envs.task_check import check_start
from manip.envs.task_errors import blamed
from manip.envs.time_step import TimeStep
from manip.envs.varied_starts import VariedStarts
from manip.envs.waypoint_starts import FAMILY, WaypointStarts
from manip.errors import UserError, at_least, check_choice, shown
from manip.looks import check_looks
from manip.robot_config import RobotConfig, check_robot_config
from manip.sim.batch_engine import BatchEngine
from manip.sim.engine import Snapshot
from manip.sim.not_copied import DeepCopied
from manip.sim.robosuite_factory import PANDA
from manip.sim.robot_motion import RobotMotion
from manip.sim.row_engine import RowEngine
from manip.sim.scene import Fidelity, Scene, load_scene
from manip.sim.scene_cameras import SceneCameras

Array = np.ndarray

DUMP_FORMAT = 2
"""Version of the files that `manip replay` reads."""

MOST_DUMPS = 20
"""Most files in a dump folder."""


class NativeBatch(DeepCopied, TaskBatch):
    """Step N environments in native threads.

    Args:
        task: the task.
        num_envs: N.
        robot: arm, controller and control frequency.
        fidelity: "exact" (stock physics) or "fast" (for training and sweeps).
        threads: native threads; the CPUs this process may use by default.
        stagger: begin the first episodes at random times, so that they do not all end
            at the same step.
        restart_fraction: fraction of the episodes that start from a previously visited
            state (see `manip.envs.restart_buffer`).
        scene: a compiled scene to share, instead of building one.
        options: as in `EpisodeOptions`.

    Raises:
        UserError: the task is another library's, or an option is out of its range.

    Attributes:
        waypoints: states from which some episodes start; None for none.
    """

    waypoints: WaypointStarts | None = None

    def __init__(
        self,
        task: Task,
        num_envs: int,
        *,
        robot: RobotConfig = PANDA,
        fidelity: Fidelity = "exact",
        threads: int | None = None,
        stagger: bool = False,
        restart_fraction: float = 0.0,
        scene: Scene | None = None,
        **options: Any,
    ) -> None:
        if isinstance(task, ExternalTask):
            raise UserError(
                f"{task.name} is not on the batch engine: use make_batch(task, ...), "
                "which steps it with its own library"
            )
        at_least(1, "num_envs", num_envs)
        at_least(1, "threads", 1 if threads is None else threads)
        check_robot_config(robot)
        check_choice("fidelity", fidelity, get_args(Fidelity))
        check_flag("stagger", stagger)
        check_share("restart_fraction", restart_fraction)
        if not isinstance(scene, Scene | None):
            raise UserError(f"scene must be a Scene, not {shown(scene)}")
        episodes = EpisodeOptions(**options)
        with blamed(task):
            self.scene = scene or load_scene(
                task.robosuite_name, task.sensors, robot, fidelity
            )
            milestones = len(task.milestone_names)
        quantities = [each.quantity for each in episodes.perturbations]
        self._varied = VariedStarts(self.scene, task.sensors, quantities)
        self.scene = self._varied.scene
        if episodes.motion:
            self.scene = replace(self.scene, with_peaks=True)
        self.engine = self._build_engine(num_envs, threads)
        self._robot_motion = RobotMotion(self.scene) if episodes.motion else None
        self._stagger = stagger
        self._restart_fraction = restart_fraction
        self._restarts = (
            RestartBuffer(milestones, self.engine.save()) if restart_fraction else None
        )
        self.robot, self.fidelity = robot, fidelity
        cameras = check_cameras(episodes.cameras)
        looks = check_looks(episodes.looks)
        self._looks = EpisodeLooks(looks, num_envs)
        self._drawn = (
            SceneCameras(self.scene, cameras, looks, self.engine.threads)
            if cameras.names
            else None
        )
        action_dim = self.scene.layout.action_dim
        super().__init__(task, num_envs, action_dim, episodes, robot.control_freq)
        with blamed(task):
            check_start(task, self.scene)

    def _build_engine(self, num_envs: int, threads: int | None) -> RowEngine:
        """The engine that steps `self.scene`."""
        return BatchEngine(self.scene, num_envs, threads)

    def read(self) -> Measures:
        """As `RowEngine.read`."""
        return self.engine.read()

    def _version(self) -> object:
        return self.engine.changes

    def visual_model(self, env_id: int) -> Any:
        """A copy of the stock model with the environment's model fields."""
        return self.engine.visual_model(self.engine.states[env_id])

    def motion(self) -> dict[str, Array]:
        """As `RobotMotion.read`."""
        motion = self._robot_motion
        return motion.read(self.engine) if motion else super().motion()

    def step(self, action: Array) -> TimeStep:
        """As `TaskBatch.step`; visited states go to the restart buffer."""
        time_step = super().step(action)
        if self.waypoints:
            self.waypoints.end(on_host(time_step.done), on_host(time_step.success))
        if self._restarts:
            now = (self.elapsed + np.arange(self.num_envs)) % INTERVAL == 0
            milestones = np.stack([*map(on_host, time_step.milestones.values())], 1)
            self._restarts.store(self.engine.save(now), milestones[now])
        return time_step

    def _draw(self, env_ids: Array) -> Mapping[str, Array]:
        """The cameras' images of the present states."""
        states, looks = self.engine.states[env_ids], self._looks.seeds[env_ids]
        return self._drawn.draw(states, looks) if self._drawn else {}

    def _start_episodes(self, env_ids: Array) -> None:
        episodes, numbers = self.episode[env_ids], self.first_env + env_ids
        streams = EpisodeStreams(self.seed, numbers, episodes, self.purpose)
        self._looks.begin(env_ids, self.seed, self.purpose, numbers, episodes)
        start = self.task.sample_start(self.scene, streams)
        if self._perturber:
            start = self._varied.apply(start, self._perturber.model_values(env_ids))
        self.engine.reset(env_ids, start.qpos, start.fields)
        if self._stagger:
            first = episodes == 0
            begun = streams.uniform(0, self.horizon, 1)[:, 0].astype(np.int64)
            self.elapsed[env_ids[first]] = begun[first]
        if self._restarts and not self._restarts.empty:
            again = streams.uniform(0, 1, 1)[:, 0] < self._restart_fraction
            visited = self._restarts.draw(streams)
            visited = Snapshot(visited.states[again], visited.readings[again])
            self.engine.restore(visited, env_ids[again])
        if self.waypoints:
            own = EpisodeStreams(self.seed, numbers, episodes, self.purpose, FAMILY)
            self.waypoints.begin(self.engine, env_ids, own)

    def _keep(self, env_ids: Array, memory: Mapping[str, Array]) -> None:
        self.engine.write_memory(env_ids, memory)

    def _move(self, action: Array) -> Array:
        self._action = action
        return self.engine.step(action)

    def _dump(self, fault: Fault) -> str:
        folder = self.dump_folder
        if not folder or not fault.step or _count(folder) >= MOST_DUMPS:
            return ""
        path = folder / f"{fault.name}.safetensors"
        self._save_step(path, fault)
        return f"; manip replay {path}"

    def _save_step(self, path: Path, fault: Fault) -> None:
        """Write the environment's state before the step, and the action."""
        from manip.io.tensor_trees import save_tree  # which loads torch

        before = self.engine.before
        step = {
            "fault": fault._asdict(),
            "task": f"{type(self.task).__module__}:{type(self.task).__qualname__}",
            "robot": self.robot._asdict(),
            "fidelity": self.fidelity,
            "reward": self.reward_set,
            "reward_weights": self.reward_weights,
            "state": before.states[fault.env_id],
            "readings": before.readings[fault.env_id],
            "action": np.asarray(on_host(self._action[fault.env_id]), float),
        }
        save_tree(path, {"format": DUMP_FORMAT, **step})

    def record(self) -> dict[str, Array]:
        """As `TaskBatch.record`: states [N, S], readings [N, R], motion [N, 3, 3],
        elapsed and episode [N].
        """
        snapshot, clocks = self.engine.save(), self._clocks()
        del clocks["fault_count"]
        return {"states": snapshot.states, "readings": snapshot.readings, **clocks}

    def save_state(self) -> dict[str, Any]:
        """Engine states, clocks, episode numbers, the restart buffer and waypoints."""
        snapshot = self.engine.save()
        return {
            "states": snapshot.states,
            "readings": snapshot.readings,
            **self._clocks(),
            **self._looks.save_state(),
            **(self._perturber.save_state() if self._perturber else {}),
            **(self.waypoints.save_state() if self.waypoints else {}),
            "restarts": self._restarts and self._restarts.save_state(),
        }

    def load_state(self, state: dict[str, Any]) -> None:
        """Restore what `save_state` returned; `observe` then shows it.

        Raises:
            UserError: the state is of other environments.
        """
        now = self.engine.save()
        states = state_array(state, "states", now.states)
        readings = state_array(state, "readings", now.readings)
        self._restore_clocks(state)
        self._looks.load_state(state)
        if self._perturber:
            self._perturber.begin(np.flatnonzero(self._begun))
            self._perturber.load_state(state)
        if self._restarts:
            self._restarts.load_state(state["restarts"])
        if self.waypoints:
            self.waypoints.load_state(state)
        self.engine.restore(Snapshot(states, readings))


def _count(folder: Path) -> int:
    return len(list(folder.iterdir())) if folder.is_dir() else 0
