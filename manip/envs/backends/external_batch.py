"""Tasks of other libraries: any robosuite environment, any dm_control.manipulation.

They are named `library/name`. Observation, reward and success are the library's own
(see manip.sim.external.robosuite_sim and manip.sim.external.dm_control_sim), and so is the speed.
"""

import importlib
from functools import partial
from types import ModuleType
from typing import Any, ClassVar

import numpy as np

from manip.cpus import usable_cpus
from manip.envs.backends.worker_pool import WorkerPool
from manip.envs.task import Measures, Start, Task
from manip.envs.task_batch import TaskBatch
from manip.errors import UserError, check_choice, shown, unknown
from manip.robot_config import RobotConfig
from manip.sim.external.external_sim import ExternalSim, ExternalStep
from manip.sim.robosuite_factory import PANDA
from manip.sim.sensors import Sensors

Array = np.ndarray

EARNED = ("reward", "success", "terminated")
"""What a world shows besides its observation."""


class ExternalTask(Task):
    """A task whose measures are what its library says of it.

    Raises:
        UserError: the library has no task of this name.
    """

    library: ClassVar[str]

    robosuite_name = ""
    sensors = Sensors()
    weights = {"stock": {"reward": 1.0}}
    milestone_names = ("success",)

    def __init__(self, environment: str) -> None:
        names = self.module().names()
        check_choice(f"{self.library} task", environment, names)
        self.environment = environment

    @classmethod
    def module(cls) -> ModuleType:
        """What steps it, with its library, which is loaded only here."""
        return importlib.import_module(f"manip.sim.external.{cls.library}_sim")

    @property
    def name(self) -> str:
        """`library/name`."""
        return f"{self.library}/{self.environment}"

    @property
    def notice(self) -> str:
        """What to expect of it."""
        return (
            f"{self.name} is stepped by {self.library} itself, tens of times slower "
            "than the batch engine"
        )

    def sample_start(self, scene: Any, streams: Any) -> Start:
        """Its library starts it."""
        raise UserError(self.notice)

    def measure(self, read: Measures) -> Measures:
        """Nothing to add."""
        return read

    def observe(self, m: Measures) -> dict[str, Array]:
        """All but what it earned."""
        return {name: part for name, part in m.items() if name not in EARNED}

    def reward_terms(self, m: Measures, reward: str) -> dict[str, Array]:
        """The library's reward."""
        return {"reward": m["reward"]}

    def success(self, m: Measures) -> Array:
        """The library's test."""
        return m["success"]

    def milestones(self, m: Measures) -> dict[str, Array]:
        """Success alone."""
        return {"success": m["success"]}

    def failure(self, m: Measures) -> Array:
        """Where the library ends an episode before its time."""
        return m["terminated"]


class DmControlTask(ExternalTask):
    """A task of dm_control.manipulation, 10 s long (its _TIME_LIMIT) at 25 Hz."""

    library = "dm_control"
    horizon = 250


class RobosuiteTask(ExternalTask):
    """A robosuite environment, as long as in robosuite's own benchmark
    (github.com/ARISE-Initiative/robosuite-benchmark).
    """

    library = "robosuite"
    horizon = 500


LIBRARIES: dict[str, type[ExternalTask]] = {
    cls.library: cls for cls in (DmControlTask, RobosuiteTask)
}


def external_names() -> list[str]:
    """`library/name` of every task that other libraries offer."""
    return [
        f"{library}/{name}"
        for library, cls in LIBRARIES.items()
        for name in cls.module().names()
    ]


def library_of(task: str) -> str:
    """The library whose physics a task runs in: `library/name`, or robosuite."""
    return task.split("/")[0] if "/" in task else "robosuite"


def load_external(name: str) -> ExternalTask:
    """The task called `library/name`.

    Raises:
        UserError: no such library or task; the message lists those that exist.
    """
    library, _, environment = name.partition("/")
    if library not in LIBRARIES:
        raise UserError(
            f"task {shown(name)}: {unknown('library', library, LIBRARIES)}; a task is a "
            "name (see `manip list`), package.module:Class for a class of your own, or "
            "library/name"
        )
    return LIBRARIES[library](environment)


class ExternalBatch(TaskBatch):
    """N worlds of another library's task, in as many processes as there are threads.

    Where they stand is saved as what they did since their episodes began, and restored
    by doing it again.

    Args:
        task: what is to be done.
        num_envs: N.
        robot: the arms, their controller and control frequency.
        fidelity, reward, restart_fraction: "exact", "stock" and 0: nothing else is possible.
        threads: processes; the CPUs this process may use unless given.
        stagger: begin the first episodes at different times, so that the worlds do not
            all end at once.
        hard_reset: rebuild robosuite's model at every reset.
        horizon, seed: as in `TaskBatch`.

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
        horizon: int | None = None,
        reward: str = "stock",
        seed: int = 0,
        stagger: bool = False,
        restart_fraction: float = 0.0,
        hard_reset: bool = False,
    ) -> None:
        if (fidelity, restart_fraction) != ("exact", 0):
            raise UserError(
                f"{task.name} has its library's own physics and starts: it needs "
                f"fidelity exact and restart_fraction 0, not {fidelity} and {restart_fraction}"
            )
        task.module().check_robot_config(robot)
        processes = min(threads or usable_cpus(), num_envs)
        make = partial(_open, task, robot, seed, hard_reset)
        self._crew = WorkerPool(make, num_envs, processes)
        first: ExternalStep = self._crew.ask("start", {0: (0,)})[0]
        self._sights = [first] * num_envs
        self._taken: list[list[Array]] = [[] for _ in range(num_envs)]
        self._stagger = stagger
        action_dim: int = self._crew.ask("action_dim", {0: ()})[0]
        super().__init__(task, num_envs, action_dim, horizon, reward, seed)

    def read(self) -> Measures:
        """The parts of the observation [N, k], and what was earned [N]."""
        sights = self._sights
        parts = {n: np.stack([s.parts[n] for s in sights]) for n in sights[0].parts}
        return parts | {n: np.array([getattr(s, n) for s in sights]) for n in EARNED}

    def visual_model(self, world: int) -> Any:
        """Not for the asking."""
        raise UserError(f"{self.task.name} is stepped elsewhere and cannot be filmed")

    def _start_episodes(self, worlds: Array) -> None:
        seeds = {world: (self.episode_seed(world),) for world in map(int, worlds)}
        for world, sight in self._crew.ask("start", seeds).items():
            self._sights[world], self._taken[world] = sight, []
            if self._stagger and self.episode[world] == 0:
                self.elapsed[world] = self.horizon * world // self.num_envs

    def episode_seed(self, world: int) -> int:
        """What a world's present episode starts from, below 2^32."""
        key = [self.seed, world, int(self.episode[world])]
        return int(np.random.SeedSequence(key).generate_state(1)[0])

    def _keep(self, worlds: Array, memory: Measures) -> None:
        """Its task remembers nothing."""

    def _move(self, action: Array) -> Array:
        broken = np.isnan(action).any(axis=1)
        calls = {int(world): (action[world],) for world in np.flatnonzero(~broken)}
        for world, sight in self._crew.ask("step", calls).items():
            self._taken[world].append(action[world].copy())
            broken[world] = sight is None
            self._sights[world] = sight or self._sights[world]
        return broken

    def save_state(self) -> dict[str, Any]:
        """Everything the coming steps depend on: clocks, episodes, actions in them."""
        empty = np.zeros((0, self.action_dim), np.float32)
        return {
            "elapsed": self.elapsed.copy(),
            "episode": self.episode.copy(),
            "actions": [np.array(taken or empty) for taken in self._taken],
            "fault_count": self.fault_count,
        }

    def load_state(self, state: dict[str, Any]) -> None:
        """Put back what `save_state` gave, by repeating it; `look` then shows it.

        Raises:
            ValueError: the state is of other worlds.
        """
        self.elapsed[:] = state["elapsed"]
        self.episode[:] = state["episode"]
        self.fault_count = state["fault_count"]
        self._taken = [list(actions) for actions in state["actions"]]
        calls = {
            world: (self.episode_seed(world), actions)
            for world, actions in enumerate(state["actions"])
        }
        found = self._crew.ask("repeat", calls)
        self._sights = [found[world] for world in range(self.num_envs)]


def _open(
    task: ExternalTask, robot: RobotConfig, seed: int, hard_reset: bool, world: int
) -> ExternalSim:
    opened: ExternalSim = task.module().open_world(
        task.environment, robot, seed + world, hard_reset
    )
    return opened
