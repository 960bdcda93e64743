"""TaskBatch: N environments of one task, stepped by a simulation backend.

Plain numpy; TorchRL, Gymnasium and dm_env environments are adapters of it.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np

from manip.arrays import all_on_host, constant, on_host
from manip.cameras import check_cameras
from manip.envs.episode_options import EpisodeOptions
from manip.envs.episode_streams import check_purpose, check_seed
from manip.envs.fault_recorder import FaultRecorder
from manip.envs.image_stacks import ImageStacks
from manip.envs.measure_cache import MeasureCache
from manip.envs.option_checks import state_array
from manip.envs.optional_abilities import OptionalAbilities
from manip.envs.perturber import Perturber
from manip.envs.reward_range import RewardRange
from manip.envs.task import Measures, Task
from manip.envs.task_check import check_memory, check_task
from manip.envs.task_errors import blamed, exits_blamed
from manip.envs.task_outputs import OutputForm, evaluate
from manip.envs.time_step import TimeStep
from manip.envs.visible_measures import VisibleMeasures
from manip.errors import UserError, at_least, check_choice
from manip.observation import ObservationSpec, vector_spec
from manip.rewards.compose import override_weights, weighted_sum
from manip.sim.actions import checked_actions
from manip.sim.env_ids import checked_env_ids

Array = np.ndarray


class TaskBatch(OptionalAbilities, FaultRecorder, ABC):
    """Base class of the backends, which move the environments.

    Args:
        task: the task.
        num_envs: N.
        action_dim: A.
        options: see `manip.envs.episode_options.EpisodeOptions`.
        control_freq: control steps a second.

    Raises:
        UserError: a function of the task returns a wrong name, shape or dtype.

    Attributes:
        observation_spec: names, shapes and roles of the observation's parts, cameras
            last.
        cameras: the cameras whose images are observed.
        reward_weights: term -> weight, as paid.
        reward_names: names of the terms, in order.
        measure_names: names of the visible measures, in order.
        control_dt: control period [s].
        elapsed: [N] control steps since each episode began.
        episode: [N] number of each environment's episode; -1 before the first.
        gives_tensors: arrays of `TimeStep`, and actions, are tensors on a device.
        faults, fault_count, stop_at_faults, dump_folder: see `FaultRecorder`.
    """

    gives_tensors = False

    def __init__(
        self,
        task: Task,
        num_envs: int,
        action_dim: int,
        options: EpisodeOptions,
        control_freq: int,
    ) -> None:
        at_least(1, "num_envs", num_envs)
        super().__init__()
        self.task = task
        self.num_envs = num_envs
        self.action_dim = action_dim
        self.control_dt = 1 / control_freq
        self.reward_set = reward = options.reward
        self.seed = check_seed(options.seed)
        self.purpose = check_purpose(options.purpose)
        self.first_env = options.first_env
        self.episode = np.full(num_envs, -1, dtype=np.int64)
        self._begun = np.zeros(num_envs, bool)
        self.elapsed = np.zeros(num_envs, dtype=np.int64)
        with blamed(task):
            check_choice("reward", reward, tuple(task.weights))
            check_task(task, self.read(), num_envs)
            self.horizon = options.horizon or task.horizon
            overrides = options.reward_weights or {}
            self.reward_weights = override_weights(task.weights[reward], overrides)
            self._cache = MeasureCache(task, num_envs, self._task_reads, self._version)
            outputs = evaluate(task, self._cache.get(), reward)
            self._visible = VisibleMeasures(
                task, num_envs, self._cache.get, self.control_dt
            )
        self.reward_names = tuple(self.reward_weights)
        self.measure_names = self._visible.names
        self.cameras = cameras = check_cameras(options.cameras)
        self._image_stacks = ImageStacks(cameras, num_envs, self._draw)
        vector = vector_spec(outputs.parts, task.proprioception)
        self.observation_spec = ObservationSpec((*vector.parts, *cameras.parts))
        self._form = OutputForm(task, outputs)
        self._range = RewardRange(task, reward == "shaped" and not overrides)
        self._last_observation = np.zeros(
            (num_envs, self.observation_spec.dim), np.float32
        )
        self._non_finite = np.zeros(num_envs, bool)
        self._perturber: Perturber | None = None
        if options.perturbations:
            self._perturber = Perturber(options.perturbations, self)

    @abstractmethod
    def read(self) -> Measures:
        """Current readings of all environments."""

    def _task_reads(self) -> Measures:
        """Current readings from which the task is evaluated."""
        return self.read()

    def _version(self) -> object:
        """A value that changes with the state; by default a new one in every call."""
        return object()

    @abstractmethod
    def visual_model(self, env_id: int) -> Any:
        """MuJoCo model that draws an environment's present episode."""

    @abstractmethod
    def _start_episodes(self, env_ids: Array) -> None:
        """Reset environments to the start of their episode `self.episode[env_ids]`."""

    @abstractmethod
    def _keep(self, env_ids: Array, memory: Mapping[str, Array]) -> None:
        """Store the task's memory of the given environments: name -> [n, k]."""

    @abstractmethod
    def _move(self, action: Array) -> Array:
        """Advance all environments one control step; [N] bool, those that diverged."""

    def _clocks(self) -> dict[str, Any]:
        """The part of the state that all backends share."""
        return {
            "elapsed": self.elapsed.copy(),
            "episode": self.episode.copy(),
            "fault_count": self.fault_count,
            "motion": self._visible.save_state(),
            **self._image_stacks.save_state(),
        }

    def _restore_clocks(self, state: dict[str, Any]) -> None:
        count = state["fault_count"]
        at_least(0, "fault_count", count)
        for name, least in (("elapsed", 0), ("episode", -1)):
            values = state_array(state, name, getattr(self, name))
            if (values < least).any():
                raise UserError(f"{name} of the saved state is below {least}")
            getattr(self, name)[:] = values
        self._visible.load_state(state)
        self.fault_count = int(count)
        self._image_stacks.load_state(state)
        self._begun = self.episode >= 0

    def restart(self, seed: int | None = None, episode: int = 0) -> None:
        """Make every environment's next episode number `episode` of the seed."""
        at_least(0, "episode", episode)
        self.seed = check_seed(self.seed if seed is None else seed)
        self.episode[:] = episode - 1
        self._begun[:] = False

    def begin(self, env_ids: Array) -> None:
        """Start the next episode in some environments.

        Args:
            env_ids: [n] int, each at most once.

        Raises:
            UserError: there are no such environments.
        """
        env_ids = checked_env_ids(env_ids, self.num_envs)
        self.episode[env_ids] += 1
        self.elapsed[env_ids] = 0
        self._begun[env_ids] = True
        if len(env_ids):
            with blamed(self.task):
                if self._perturber:
                    self._perturber.begin(env_ids)
                with self._cache.restarting(env_ids):
                    self._start_episodes(env_ids)
                self._update_memory(env_ids)
                self._visible.begin(env_ids)
                if self._perturber:
                    self._perturber.observe_start(env_ids, self.read(), self.elapsed)
            self._image_stacks.restart(env_ids)

    def step(self, action: Array) -> TimeStep:
        """Advance all environments by one control step.

        Args:
            action: [N, A] in [-1, 1]; a torch tensor with `gives_tensors`.

        Raises:
            UserError: the action has another shape or holds no real numbers, or an
                environment has not begun an episode.
        """
        if not self.gives_tensors:
            checked_actions(action, self.num_envs, self.action_dim)
            action = np.asarray(action)
        if not self._begun.all():
            raise UserError("step() was called before reset(): begin an episode first")
        perturber = self._perturber
        with exits_blamed(self.task):
            diverged = self._move(
                perturber.act(action, self.elapsed) if perturber else action
            )
        self.elapsed += 1
        self._image_stacks.append()
        if diverged.any():
            no_number = diverged & np.isnan(on_host(action)).any(axis=1)
            self._record_faults(
                [("action", no_number), ("physics", diverged & ~no_number)]
            )
        with blamed(self.task):
            if self._perturber:
                self._perturber.observe_step(self.read(), self.elapsed)
            time_step = self._time_step((self.elapsed >= self.horizon) | diverged)
            self._visible.step()
            self._update_memory(np.flatnonzero(~diverged))
        return time_step

    def observe(self) -> TimeStep:
        """The current state as a TimeStep, as after a reset: no episode has ended.

        Raises:
            UserError: rewards and observations of all environments are not finite.
        """
        never = np.zeros(self.num_envs, bool)
        with blamed(self.task):
            time_step = self._time_step(never)
        if self._non_finite.all():
            raise UserError(f"{self.faults[-1]}, and so are all other environments")
        never = constant(never, time_step.terminated)
        return time_step._replace(terminated=never, truncated=never)

    def measures(self) -> Array:
        """[N, M] float32: the present visible measures, named as `measure_names`."""
        with blamed(self.task):
            return self._visible.get()

    def expert(self) -> Array:
        """[N, A]: the action of the task's expert in the present state.

        Raises:
            UserError: the task has none, or its action has a wrong shape.
        """
        with blamed(self.task):
            action = self.task.expert(all_on_host(self._cache.get()))
        if np.shape(action) != (self.num_envs, self.action_dim):
            raise UserError(
                f"task {self.task.name!r}: expert(m) has shape {np.shape(action)}, not "
                f"{(self.num_envs, self.action_dim)}"
            )
        return action

    def _update_memory(self, env_ids: Array) -> None:
        if self.task.sensors.memory and len(env_ids):
            memory = self.task.update_memory(self._cache.get())
            check_memory(self.task, memory, self.num_envs)
            self._keep(
                env_ids, {name: values[env_ids] for name, values in memory.items()}
            )

    def _time_step(self, over: Array) -> TimeStep:
        outputs = evaluate(self.task, self._cache.get(), self.reward_set)
        self._form.check(outputs)
        terminated = outputs.failure
        reward = weighted_sum(outputs.terms, self.reward_weights)
        self._range.check(reward)
        observation = self.observation_spec.join(outputs.parts)
        if self._perturber:
            observation = self._perturber.observation(self.elapsed)
        time_step = TimeStep(
            observation=observation,
            reward=reward,
            reward_terms=outputs.terms,
            success=outputs.success,
            milestones=outputs.milestones,
            terminated=terminated,
            truncated=constant(over, terminated) & ~terminated,
            images=self._image_stacks.now,
        )
        finite = time_step.finite()
        self._non_finite = ~finite
        if not finite.all():
            self._record_outputs(outputs)
            time_step = time_step.cut_off(finite, self._last_observation)
        self._last_observation = time_step.observation
        return time_step
