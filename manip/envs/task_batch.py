"""N worlds of a task, whatever steps them: their episodes, and what is seen of them.

Plain numpy: what TorchRL, Gymnasium and dm_env see of a task are adaptors of this.
"""

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from manip.envs.faults import Fault, not_finite
from manip.envs.task import Measures, Task
from manip.envs.task_check import blamed, check_task
from manip.errors import UserError, check_choice
from manip.rewards.compose import weighted_sum

Array = np.ndarray


class TimeStep(NamedTuple):
    """N worlds at one instant; the observation [N, D] is float32, flags are [N] bool.

    reward_terms and milestones hold [N] under each name of the worlds' `reward_names` and
    of task.milestone_names. terminated: the task failed, there is no future; truncated: time is
    up, or the world broke; bootstrap through it.
    """

    observation: Array
    reward: Array
    reward_terms: Mapping[str, Array]
    success: Array
    milestones: Mapping[str, Array]
    terminated: Array
    truncated: Array

    @property
    def done(self) -> Array:
        """[N] bool: the episode is over."""
        return self.terminated | self.truncated


class TaskBatch(ABC):
    """Base of the worlds on the engine and in stock robosuite; subclasses move them.

    Args:
        task: what is to be done.
        num_envs: N.
        action_dim: A.
        horizon: episode length [control steps]; the task's own unless given.
        reward: which of the task's reward sets is paid, "shaped" or "stock".
        seed: of all episodes; episode e of world w depends on (seed, w, e) only.

    Raises:
        UserError: a function of the task gives something of the wrong name or shape.

    Attributes:
        layout: observation part -> slice of the observation vector.
        elapsed: [N] control steps since each world's episode began.
        episode: [N] number of each world's episode; -1 before the first.
        faults: the latest worlds that were lost; whoever tells of them removes them.
        fault_count: how many were lost so far.
        stop_at_faults: whether a world that is lost is an error.
    """

    stop_at_faults = False

    def __init__(
        self,
        task: Task,
        num_envs: int,
        action_dim: int,
        horizon: int | None,
        reward: str,
        seed: int,
    ) -> None:
        with blamed(task):
            check_choice("reward", reward, tuple(task.weights))
            self.reward_names = tuple(task.weights[reward])
        self.task = task
        self.num_envs = num_envs
        self.action_dim = action_dim
        self.horizon = horizon or task.horizon
        self.reward_set = reward
        self.elapsed = np.zeros(num_envs, dtype=np.int64)
        self.faults: deque[Fault] = deque(maxlen=1000)
        self.fault_count = 0
        self._lost = np.zeros(num_envs, bool)
        with blamed(task):
            check_task(task, self.read(), num_envs)
            self.layout = _layout(task.observe(task.measure(self.read())))
        width = max(part.stop for part in self.layout.values())
        self._seen = np.zeros((num_envs, width), np.float32)
        self.seed = seed
        self.restart()

    @abstractmethod
    def read(self) -> Measures:
        """Current readings of all worlds."""

    @abstractmethod
    def visual_model(self, world: int) -> Any:
        """MuJoCo model that draws a world's present episode (manip.sim.renderer)."""

    @abstractmethod
    def _start_episodes(self, worlds: Array) -> None:
        """Put the given worlds at the start of their episode `self.episode[worlds]`."""

    @abstractmethod
    def _keep(self, worlds: Array, memory: Mapping[str, Array]) -> None:
        """Keep what the task remembers of the given worlds: name -> [n, k]."""

    @abstractmethod
    def _move(self, action: Array) -> Array:
        """Advance all worlds by one control step; [N] bool, the worlds that broke."""

    def save_state(self) -> dict[str, Any]:
        """Everything the coming steps depend on."""
        raise UserError(f"{type(self).__name__} cannot save its state")

    def load_state(self, state: dict[str, Any]) -> None:
        """Put back what `save_state` gave; `observe` then shows it."""
        raise UserError(f"{type(self).__name__} cannot restore a state")

    def restart(self, seed: int | None = None) -> None:
        """Begin anew: every world's next episode is the first of the seed."""
        self.seed = self.seed if seed is None else seed
        self.episode = np.full(self.num_envs, -1, dtype=np.int64)

    def check_layout(self, layout: Mapping[str, Sequence[int]]) -> None:
        """Compare the observation with the one that a policy was trained on.

        Args:
            layout: part -> start and stop in the observation vector.

        Raises:
            UserError: the parts differ, in what they are, where, or how wide.
        """
        mine = {name: [part.start, part.stop] for name, part in self.layout.items()}
        theirs = {name: list(part) for name, part in layout.items()}
        if mine != theirs:
            both = mine.keys() | theirs.keys()
            parts = sorted(name for name in both if mine.get(name) != theirs.get(name))
            raise UserError(
                f"the policy was trained on another observation than {self.task.name} "
                f"shows: {', '.join(parts)} differ"
            )

    def begin(self, worlds: Array) -> None:
        """Start the next episode in some worlds [n] int."""
        self.episode[worlds] += 1
        self.elapsed[worlds] = 0
        if len(worlds):
            with blamed(self.task):
                self._start_episodes(worlds)
                self._remember(worlds)

    def step(self, action: Array) -> TimeStep:
        """Advance all worlds by one control step of action [N, A] in [-1, 1]."""
        broken = self._move(action)
        self.elapsed += 1
        if broken.any():
            ill = broken & np.isnan(action).any(axis=1)
            self._note([("action", ill), ("physics", broken & ~ill)])
        with blamed(self.task):
            time_step = self._time_step((self.elapsed >= self.horizon) | broken)
            self._remember(np.flatnonzero(~broken))
        return time_step

    def observe(self) -> TimeStep:
        """The worlds as they are now, as an episode begins: nothing has ended.

        Raises:
            UserError: nothing that is seen of them is finite, in any world.
        """
        never = np.zeros(self.num_envs, bool)
        with blamed(self.task):
            time_step = self._time_step(never)
        if self._lost.all():
            raise UserError(f"{self.faults[-1]}, nor of any other")
        return time_step._replace(terminated=never, truncated=never)

    def expert(self) -> Array:
        """[N, A]: what the task's script would do now.

        Raises:
            UserError: the task has none.
        """
        with blamed(self.task):
            return self.task.expert(self.task.measure(self.read()))

    def _remember(self, worlds: Array) -> None:
        if self.task.sensors.memory:
            memory = self.task.update_memory(self.task.measure(self.read()))
            self._keep(
                worlds, {name: values[worlds] for name, values in memory.items()}
            )

    def _time_step(self, over: Array) -> TimeStep:
        task = self.task
        m = task.measure(self.read())
        parts, terms = task.observe(m), task.reward_terms(m, self.reward_set)
        terminated = task.failure(m)
        time_step = TimeStep(
            observation=_joined(parts),
            reward=weighted_sum(terms, task.weights[self.reward_set]),
            reward_terms=terms,
            success=task.success(m),
            milestones=task.milestones(m),
            terminated=terminated,
            truncated=over & ~terminated,
        )
        fine = np.isfinite(time_step.reward) & np.isfinite(time_step.observation).all(
            axis=1
        )
        self._lost = ~fine
        if self._lost.any():
            self._note(
                not_finite("observation", parts, self.num_envs)
                + not_finite("reward term", terms, self.num_envs)
            )
            time_step = self._without(time_step, fine)
        self._seen = time_step.observation
        return time_step

    def _without(self, time_step: TimeStep, fine: Array) -> TimeStep:
        """The time_step with the lost worlds as last seen, their episodes cut off."""
        kept = {
            "milestones": time_step.milestones,
            "reward_terms": time_step.reward_terms,
        }
        return TimeStep(
            observation=np.where(fine[:, None], time_step.observation, self._seen),
            reward=np.where(fine, time_step.reward, 0.0),
            success=time_step.success & fine,
            terminated=time_step.terminated & fine,
            truncated=time_step.truncated | ~fine,
            **{
                kind: {
                    name: np.where(fine, values, 0).astype(values.dtype)
                    for name, values in named.items()
                }
                for kind, named in kept.items()
            },
        )

    def _note(self, found: Sequence[tuple[str, Array]]) -> None:
        """Report what is wrong, and in which worlds [N] bool."""
        wrong = np.any([where for _, where in found], axis=0)
        for world in map(int, np.flatnonzero(wrong)):
            what = ", ".join(name for name, where in found if where[world])
            clock = int(self.episode[world]), int(self.elapsed[world])
            self._report(Fault(self.task.name, what, world, *clock))

    def _report(self, fault: Fault) -> None:
        self.faults.append(fault)
        self.fault_count += 1
        kept = self._kept(fault)
        if self.stop_at_faults:
            raise UserError(f"{fault}{kept}")

    def _kept(self, fault: Fault) -> str:
        """How to see the fault again, if that was kept."""
        return ""


def _layout(parts: Mapping[str, Array]) -> dict[str, slice]:
    layout, at = {}, 0
    for name, part in parts.items():
        layout[name] = slice(at, at + part.shape[1])
        at += part.shape[1]
    return layout


def _joined(parts: Mapping[str, Array]) -> Array:
    with np.errstate(over="ignore"):
        return np.concatenate(list(parts.values()), axis=1, dtype=np.float32)
