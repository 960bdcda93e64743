"""Tasks as Gymnasium environments: N in a VectorEnv, or one in an Env.

Importing this module registers every task as `manip/<task>-v0`::

    import gymnasium
    import manip.envs.adapters.gymnasium

    envs = gymnasium.make_vec("manip/Lift-v0", num_envs=64)  # the batch engine
    env = gymnasium.make("manip/Lift-v0", backend="stock")  # robosuite itself

`info` holds `success`, and `milestones` and `reward_terms` by their names. A time limit
is a truncation, and so is a simulation that diverges.

Options of both functions; docs/gymnasium.md explains them::

    robot             arm name, or RobotConfig(arm, controller, control_freq)
    backend           "native", or "stock" (robosuite, one environment)
    reward            reward set: "shaped" or "stock"
    reward_weights    {term: weight} that replace those of the set
    max_episode_steps length of an episode [control steps]; the task's own by default
    fidelity          "exact" or "fast" physics (native)
    threads           native threads (native)
    stagger           begin the first episodes at random times (native)
    restart_fraction  fraction of episodes from visited states (native)
    hard_reset        rebuild the model at every reset (stock)
    perturbations     what differs from the nominal task (`manip.envs.perturbation`)
    cameras           cameras to observe; the observation is then a dict (see
                      `manip.envs.adapters.gymnasium_observations`)
    image_size        height and width of an image [pixels], 64 by default
    image_quality     "exact" (robosuite's images) or "lean" (cheaper, to train on)
    frames            number of latest images that are stacked, 1 by default
    looks             strength of random changes of the images, or a suite (native)

Of `gymnasium.make`, and `make_vec(..., vectorization_mode="sync" | "async")`, only::

    render_mode       "rgb_array" to render
"""

import warnings
from collections.abc import Generator, Iterator, Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from manip.envs.adapters.gymnasium_observations import (
    Observation,
    observation_of,
    observation_space,
    observations,
    with_cameras,
)
from manip.envs.make_batch import PANDA, Backend, make_batch, robot_config_of
from manip.envs.task_batch import TaskBatch
from manip.envs.task_registry import load_task, task_names
from manip.envs.time_step import TimeStep
from manip.errors import MOST, UserError, check_choice
from manip.robot_config import RobotConfig
from manip.sim.actions import batch_of_one
from manip.sim.renderer import render_frames

Array = np.ndarray

ENDLESS = MOST
"""Horizon of an Env, whose time limit is a wrapper of Gymnasium's."""


class TaskVectorEnv(VectorEnv):
    """N environments of a task on the batch engine, as `gymnasium.make_vec` makes.

    An environment that ends starts its next episode in the same step, which returns
    the new observation; `info["final_obs"]` and `info["final_info"]` hold the end of
    the old one. Environment i has the same episodes for any N.

    Args:
        task: name of the task, or package.module:Task.
        num_envs: N.
        max_episode_steps: length of an episode; the task's own by default.
        options: see the module's table.
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}

    def __init__(
        self,
        task: str,
        num_envs: int = 1,
        *,
        max_episode_steps: int | None = None,
        **options: Any,
    ) -> None:
        _check_names(options)
        if options.pop("render_mode", None):
            raise UserError(
                "the vector environment does not render: choose "
                "vectorization_mode='sync', or make one environment"
            )
        options = with_cameras(options)
        self.batch = make_batch(
            task, num_envs, horizon=max_episode_steps, seed=0, **options
        )
        self.num_envs = num_envs
        self.single_observation_space = observation_space(self.batch)
        self.single_action_space = _action_space(self.batch)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode everywhere: the seed's first one if a seed is given."""
        if options and "reset_mask" in options:
            raise UserError(
                "reset_mask is not supported: an environment restarts in the step in "
                "which its episode ends, and reset() restarts all"
            )
        super().reset(seed=seed)
        _begin(self, seed)
        time_step = self.batch.observe()
        return observations(self.batch, time_step), _batched(
            _info(time_step), np.ones(self.num_envs, bool)
        )

    def step(
        self, actions: Array
    ) -> tuple[Observation, Array, Array, Array, dict[str, Any]]:
        """Take actions [N, A]: observations [N, D], rewards and ends [N], and info."""
        time_step = now = self.batch.step(actions)
        ends: dict[str, Any] = {}
        if time_step.done.any():
            ends = _batched(_final(self.batch, time_step), time_step.done)
            self.batch.begin(np.flatnonzero(time_step.done))
            now = self.batch.observe()
        info = _batched(_info(now), np.ones(self.num_envs, bool)) | ends
        return (
            observations(self.batch, now),
            time_step.reward,
            time_step.terminated,
            time_step.truncated,
            info,
        )


class TaskEnv(gymnasium.Env):
    """One environment of a task, which `gymnasium.make` wraps in a time limit.

    Args:
        task: name of the task, or package.module:Task.
        backend: "native" for the batch engine, "stock" for robosuite itself.
        render_mode: "rgb_array", if `render` is to draw.
        robot: arm name, or arm, controller and control frequency.
        options: see the module's table.
    """

    metadata = {"render_modes": ["rgb_array"]}

    def __init__(
        self,
        task: str,
        *,
        backend: Backend = "native",
        render_mode: str | None = None,
        robot: RobotConfig | str = PANDA,
        **options: Any,
    ) -> None:
        _check_names(options)
        if render_mode is not None:
            check_choice("render mode", render_mode, self.metadata["render_modes"])
        robot = robot_config_of(robot)
        options = with_cameras(options)
        self.metadata = self.metadata | {"render_fps": robot.control_freq}
        self.batch = make_batch(
            task, backend=backend, robot=robot, horizon=ENDLESS, seed=0, **options
        )
        self.observation_space = observation_space(self.batch)
        self.action_space = _action_space(self.batch)
        self.render_mode = render_mode
        self._frames: Generator[Array, None, None] | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start the next episode: the seed's first one if a seed is given."""
        super().reset(seed=seed)
        _begin(self, seed)
        self.close()
        time_step = self.batch.observe()
        return observation_of(self.batch, time_step, 0), _first(_info(time_step))

    def step(
        self, action: Array
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Take an action [A]: observation [D], reward, terminated, truncated, info."""
        time_step = self.batch.step(batch_of_one(action, self.batch.action_dim))
        return (
            observation_of(self.batch, time_step, 0),
            float(time_step.reward[0]),
            bool(time_step.terminated[0]),
            bool(time_step.truncated[0]),
            _first(_info(time_step)),
        )

    def render(self) -> Array | None:
        """The present state, uint8 [480, 640, 3], if the mode is "rgb_array"."""
        if self.render_mode is None:
            return None
        if self._frames is None:
            self._frames = render_frames(self.batch.visual_model(0), _poses(self.batch))
        return next(self._frames)

    def close(self) -> None:
        """Close the renderer."""
        if self._frames:
            self._frames.close()
            self._frames = None


def _check_names(options: Mapping[str, Any]) -> None:
    """Refuse options of `make_batch` that Gymnasium calls otherwise."""
    names = {"horizon": "max_episode_steps", "seed": "reset(seed=...)"}
    for name in names.keys() & options.keys():
        raise UserError(f"option {name!r} is not Gymnasium's: use {names[name]}")


def _poses(batch: TaskBatch) -> Iterator[Array]:
    while True:
        yield batch.read()["qpos"][0]


def _action_space(batch: TaskBatch) -> Box:
    return Box(-1.0, 1.0, (batch.action_dim,), np.float32)


def _begin(env: TaskEnv | TaskVectorEnv, seed: int | None) -> None:
    """Start episodes; without any seed so far, those of a random seed."""
    batch = env.batch
    if seed is None and batch.episode[0] < 0:
        seed = int(env.np_random.integers(2**63))
    if seed is not None:
        batch.restart(seed)
    batch.begin(np.arange(batch.num_envs))


def _info(time_step: TimeStep) -> dict[str, Any]:
    terms = time_step.reward_terms.items()
    return {
        "success": time_step.success,
        "milestones": dict(time_step.milestones),
        "reward_terms": {name: np.array(term, float) for name, term in terms},
    }


def _final(batch: TaskBatch, time_step: TimeStep) -> dict[str, Any]:
    last = np.full(len(time_step.done), None, object)
    for env_id in np.flatnonzero(time_step.done):
        last[env_id] = observation_of(batch, time_step, int(env_id))
    return {"final_obs": last, "final_info": _info(time_step)}


def _first(info: Mapping[str, Any]) -> dict[str, Any]:
    """The info of environment 0 alone, in Python's numbers."""
    return {
        name: _first(value) if isinstance(value, dict) else value[0].item()
        for name, value in info.items()
    }


def _batched(info: Mapping[str, Any], has_entry: Array) -> dict[str, Any]:
    """Info as Gymnasium batches it: each entry, 0 where it is missing, and a mask."""
    batched: dict[str, Any] = {}
    for name, value in info.items():
        if isinstance(value, dict):
            batched[name] = _batched(value, has_entry)
        else:
            batched[name] = value if value.dtype == object else value * has_entry
        batched[f"_{name}"] = has_entry.copy()
    return batched


def _register(name: str) -> None:
    """Register a task; one that cannot be loaded must not hide the others."""
    try:
        horizon = load_task(name).horizon
    except UserError as error:
        warnings.warn(f"manip/{name}-v0 is not registered: {error}", stacklevel=2)
        return
    gymnasium.register(
        f"manip/{name}-v0",
        entry_point=f"{__name__}:TaskEnv",
        vector_entry_point=f"{__name__}:TaskVectorEnv",
        max_episode_steps=horizon,
        kwargs={"task": name},
    )


for _name in task_names():
    _register(_name)
