"""TimeStep: the result of one control step of a batch of environments."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from manip.arrays import constant, namespace

Array = np.ndarray


class TimeStep(NamedTuple):
    """The state of N environments at one instant.

    From a batch with `gives_tensors`, the arrays are torch tensors.

    Attributes:
        observation: [N, D] float32, the joined parts of `TaskBatch.observation_spec`.
        reward: [N], the weighted sum of the reward terms.
        reward_terms: name -> [N] raw terms, named as `TaskBatch.reward_names`.
        success: [N] bool.
        milestones: name -> [N] bool, named as `Task.milestone_names`.
        terminated: [N] bool, the task failed: there is no future.
        truncated: [N] bool, time is up or the simulation diverged: bootstrap.
        images: camera part -> uint8 [N, H, W, C], named as in
            `TaskBatch.observation_spec`; empty without cameras.
    """

    observation: Array
    reward: Array
    reward_terms: Mapping[str, Array]
    success: Array
    milestones: Mapping[str, Array]
    terminated: Array
    truncated: Array
    images: Mapping[str, Array] = {}

    @property
    def done(self) -> Array:
        """[N] bool: the episode is over."""
        return self.terminated | self.truncated

    def finite(self) -> Array:
        """[N] bool: reward and observation are finite."""
        xp = namespace(self.reward)
        finite: Array = xp.isfinite(self.reward)
        return finite & xp.isfinite(self.observation).all(axis=1)

    def cut_off(self, valid: Array, last_observation: Array) -> "TimeStep":
        """Truncate environments whose numbers are not valid [N] bool.

        They keep the observation that they had before, and earn nothing.
        """
        xp = namespace(valid)

        def zeroed(named: Mapping[str, Array]) -> dict[str, Array]:
            return {
                name: xp.where(valid, values, xp.zeros_like(values))
                for name, values in named.items()
            }

        last = constant(last_observation, self.observation)
        return TimeStep(
            observation=xp.where(valid[:, None], self.observation, last),
            reward=xp.where(valid, self.reward, 0.0),
            reward_terms=zeroed(self.reward_terms),
            success=self.success & valid,
            milestones=zeroed(self.milestones),
            terminated=self.terminated & valid,
            truncated=self.truncated | ~valid,
            images=self.images,
        )
