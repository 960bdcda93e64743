"""Gymnasium's vector environments as Stable-Baselines3's."""

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from stable_baselines3.common.vec_env import VecEnv

from manip.errors import UserError

Array = np.ndarray
Observation = Array | dict[str, Array]


class Sb3VecEnv(VecEnv):
    """A VecEnv of a Gymnasium VectorEnv with autoreset in the same step.

    `SAC("MlpPolicy", Sb3VecEnv(gymnasium.make_vec("manip/Reach-v0", num_envs=16)))`.
    With `cameras=...` observations are dicts: choose "MultiInputPolicy", whose
    convolutions need images of at least 36 pixels.
    At the end of an episode `info` holds the keys that Stable-Baselines3 reads:
    `terminal_observation`, `TimeLimit.truncated` and `is_success`.
    """

    def __init__(self, envs: VectorEnv) -> None:
        mode = envs.metadata.get("autoreset_mode")
        if mode != AutoresetMode.SAME_STEP:
            raise UserError(
                f"environments must restart in the same step, but have autoreset mode "
                f"{mode}: build them with AutoresetMode.SAME_STEP"
            )
        self.envs = envs
        super().__init__(
            envs.num_envs, envs.single_observation_space, envs.single_action_space
        )

    def reset(self) -> Observation:
        """Start an episode in every environment; observations [N, D]."""
        observation, _ = self.envs.reset(seed=self._seeds[0])
        self._reset_seeds()
        return observation

    def step_async(self, actions: Array) -> None:
        """Store the actions [N, A] for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[Observation, Array, Array, list[dict[str, Any]]]:
        """Take the actions: observations [N, D], rewards [N], done [N], infos."""
        observation, reward, terminated, truncated, info = self.envs.step(self._actions)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        done = terminated | truncated
        for env_id in np.flatnonzero(done):
            infos[env_id] = {
                "terminal_observation": info["final_obs"][env_id],
                "TimeLimit.truncated": bool(truncated[env_id] & ~terminated[env_id]),
                "is_success": bool(info["final_info"]["success"][env_id]),
            }
        return observation, reward.astype(np.float32), done, infos

    def close(self) -> None:
        """Close the environments."""
        self.envs.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The vector environment's attribute, once for each environment."""
        value = getattr(self.envs, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Raise NotImplementedError: single environments have no attributes."""
        raise NotImplementedError(
            "the environments of a batch cannot have different attributes"
        )

    def env_method(
        self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any
    ) -> list[Any]:
        """Raise NotImplementedError: single environments have no methods."""
        raise NotImplementedError(
            "the environments of a batch have no separate methods: call them on `envs`"
        )

    def env_is_wrapped(
        self, wrapper_class: type[gymnasium.Wrapper], indices: Any = None
    ) -> Sequence[bool]:
        """Never: what wraps the batch wraps no single environment."""
        return [False for _ in self._get_indices(indices)]
