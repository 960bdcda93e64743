"""Collecting experience: the worlds move on where they stopped."""

from collections.abc import Callable

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase


class Rollout:
    """Steps an environment with a policy; episodes go on across calls.

    Ten lines instead of torchrl.collectors.Collector, because where the worlds stand
    must be saved and restored for a run to resume.
    """

    def __init__(self, env: EnvBase, policy: TensorDictModuleBase) -> None:
        self._env = env
        self._policy = policy
        self.state = env.reset()

    def collect(
        self, length: int, watch: Callable[[TensorDictBase], None]
    ) -> TensorDictBase:
        """The next `length` steps of all worlds, [N, length]; `watch` sees each."""
        steps = []
        for _ in range(length):
            step, self.state = self._env.step_and_maybe_reset(self._policy(self.state))
            watch(step["next"])
            steps.append(step)
        return torch.stack(steps, 1)
