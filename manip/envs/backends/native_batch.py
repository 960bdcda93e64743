"""A task on the batch engine: robosuite's MDP at native speed, N worlds at once."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from manip.envs.backends.external_batch import ExternalTask
from manip.envs.episode_streams import EpisodeStreams
from manip.envs.faults import Fault
from manip.envs.restart_buffer import EVERY, RestartBuffer
from manip.envs.task import Measures, Task
from manip.envs.task_batch import TaskBatch, TimeStep
from manip.envs.task_check import blamed, check_start
from manip.errors import UserError
from manip.robot_config import RobotConfig
from manip.sim.batch_engine import BatchEngine, Snapshot
from manip.sim.not_copied import DeepCopied
from manip.sim.robosuite_factory import PANDA
from manip.sim.scene import Fidelity, Scene, load_scene

DUMP_FORMAT = 1
"""Version of the files that `manip replay` reads."""

MOST_DUMPS = 20
"""Files kept a run."""


class NativeBatch(DeepCopied, TaskBatch):
    """TaskBatch of a task on the batch engine.

    Args:
        task: what is to be done.
        num_envs: N.
        robot: arm, controller and control frequency.
        fidelity: "exact" (stock physics) or "fast" (for training and sweeps).
        threads: native threads; the CPUs this process may use unless given.
        stagger: begin the first episodes at random times, so that the worlds do not
            all end at once.
        restart_fraction: share of the episodes that begin in a state which the worlds have
            been in before (see `manip.envs.restart_buffer`).
        scene: a compiled scene to share, instead of building one.
        dumps: folder for the steps that went wrong, a file each, for `manip replay`;
            nothing is kept unless given.
        horizon, reward, seed: as in `TaskBatch`.

    Raises:
        UserError: the task is another library's.
    """

    def __init__(
        self,
        task: Task,
        num_envs: int,
        *,
        robot: RobotConfig = PANDA,
        fidelity: Fidelity = "exact",
        threads: int | None = None,
        horizon: int | None = None,
        reward: str = "shaped",
        seed: int = 0,
        stagger: bool = False,
        restart_fraction: float = 0.0,
        scene: Scene | None = None,
        dumps: Path | None = None,
    ) -> None:
        if isinstance(task, ExternalTask):
            raise UserError(f"{task.name} is not on the batch engine")
        with blamed(task):
            self.scene = scene or load_scene(
                task.robosuite_name, task.sensors, robot, fidelity
            )
            milestones = len(task.milestone_names)
        self.engine = BatchEngine(self.scene, num_envs, threads)
        self._stagger = stagger
        self._own_starts = restart_fraction
        self._bank = (
            RestartBuffer(milestones, self.engine.save()) if restart_fraction else None
        )
        self._robot, self._fidelity = robot, fidelity
        self._dumps = dumps
        self._before = self.engine.save(), np.zeros(0)
        action_dim = self.scene.layout.action_dim
        super().__init__(task, num_envs, action_dim, horizon, reward, seed)
        with blamed(task):
            check_start(task, self.scene)

    def read(self) -> Measures:
        """As `BatchEngine.read`."""
        return self.engine.read()

    def visual_model(self, world: int) -> Any:
        """A copy of the stock model with the world's model fields."""
        return self.engine.visual_model(self.engine.states[world])

    def step(self, action: np.ndarray) -> TimeStep:
        """As `TaskBatch.step`; the bank looks at every world once in a while."""
        time_step = super().step(action)
        if self._bank:
            now = (self.elapsed + np.arange(self.num_envs)) % EVERY == 0
            milestones = np.stack([*time_step.milestones.values()], axis=1)
            self._bank.keep(self.engine.save(now), milestones[now])
        return time_step

    def _start_episodes(self, worlds: np.ndarray) -> None:
        episodes = self.episode[worlds]
        streams = EpisodeStreams(self.seed, worlds, episodes)
        start = self.task.sample_start(self.scene, streams)
        self.engine.reset(worlds, start.qpos, start.fields)
        if self._stagger:
            first = episodes == 0
            begun = streams.uniform(0, self.horizon, 1)[:, 0].astype(np.int64)
            self.elapsed[worlds[first]] = begun[first]
        if self._bank and not self._bank.empty:
            again = streams.uniform(0, 1, 1)[:, 0] < self._own_starts
            past = self._bank.draw(streams)
            past = Snapshot(past.states[again], past.readings[again])
            self.engine.restore(past, worlds[again])

    def _keep(self, worlds: np.ndarray, memory: Mapping[str, np.ndarray]) -> None:
        self.engine.write_memory(worlds, memory)

    def _move(self, action: np.ndarray) -> np.ndarray:
        if self._dumps:
            self._before = self.engine.save(), action
        return self.engine.step(action)

    def _kept(self, fault: Fault) -> str:
        if not self._dumps or not fault.step or _count(self._dumps) >= MOST_DUMPS:
            return ""
        return f"; manip replay {self._dump(self._dumps, fault)}"

    def _dump(self, folder: Path, fault: Fault) -> Path:
        """Keep what the world was before the step, and the action."""
        from manip.io.tensor_trees import save_tree  # which loads torch

        path = folder / f"{fault.name}.safetensors"
        before, action = self._before
        step = {
            "fault": fault._asdict(),
            "task": f"{type(self.task).__module__}:{type(self.task).__qualname__}",
            "robot": self._robot._asdict(),
            "fidelity": self._fidelity,
            "reward": self.reward_set,
            "state": before.states[fault.world],
            "readings": before.readings[fault.world],
            "action": np.asarray(action[fault.world], float),
        }
        save_tree(path, {"format": DUMP_FORMAT, **step})
        return path

    def save_state(self) -> dict[str, Any]:
        """Everything the coming steps depend on: worlds, clocks, episode counts."""
        snapshot = self.engine.save()
        return {
            "states": snapshot.states,
            "readings": snapshot.readings,
            "elapsed": self.elapsed.copy(),
            "episode": self.episode.copy(),
            "fault_count": self.fault_count,
            "bank": self._bank and self._bank.save_state(),
        }

    def load_state(self, state: dict[str, Any]) -> None:
        """Put back what `save_state` gave; `look` then shows it.

        Raises:
            ValueError: the state is of other worlds.
        """
        self.engine.restore(Snapshot(state["states"], state["readings"]))
        self.elapsed[:] = state["elapsed"]
        self.episode[:] = state["episode"]
        self.fault_count = state["fault_count"]
        if self._bank:
            self._bank.load_state(state["bank"])


def _count(folder: Path) -> int:
    return len(list(folder.iterdir())) if folder.is_dir() else 0
