"""Record clips of a policy or an expert, disturbed so that there is a choice.

A policy that always acts alike gives clips that are all equally good.
"""

from collections.abc import Callable

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor

from manip.envs.adapters.torchrl import TaskEnv
from manip.errors import UserError
from manip.preferences.clip_pool import cut_clips
from manip.preferences.clip_source import ClipSource
from manip.preferences.clips import Clip

NOISE_STEPS = 10
"""Mean number of control steps for which a noise sample is used, as in `--algo bc`."""

Act = Callable[[TensorDictBase], Tensor]
"""Returns the actions [N, A] in the states [N] of a `TaskEnv`."""


class Variety:
    """Act more slowly, and with noise that lasts several steps.

    Both grow over the environments, from none in the first to `most` in the last.

    Args:
        act: chooses the actions.
        num_envs: N.
        most: largest standard deviation of the noise [action in -1..1], and largest
            fraction by which the arm is slowed down, at random for an episode.
        seed: of the random numbers.
    """

    def __init__(self, act: Act, num_envs: int, most: float, seed: int) -> None:
        self._act, self._rng = act, np.random.default_rng(seed)
        self._level = np.linspace(0, most, num_envs)[:, None]
        self._speed = 1 - np.minimum(self._level, 1) * self._rng.random((num_envs, 1))
        self._noise: np.ndarray | None = None

    def __call__(self, state: TensorDictBase) -> Tensor:
        """The disturbed actions [N, A]; the gripper's is not disturbed."""
        action = self._act(state).numpy().copy()
        arm = action[:, :-1] * self._speed + self._level * self._next_noise(action)
        action[:, :-1] = np.clip(arm, -1, 1)
        return torch.from_numpy(action)

    def _next_noise(self, action: np.ndarray) -> np.ndarray:
        """Standard normal noise [N, A - 1]; rows are redrawn at random times."""
        drawn = self._rng.standard_normal(action[:, :-1].shape)
        renewed = self._rng.random((len(action), 1)) < 1 / NOISE_STEPS
        if self._noise is None:
            self._noise = drawn
        self._noise = np.where(renewed, drawn, self._noise)
        return self._noise


@torch.no_grad()
def record_clips(
    env: TaskEnv, act: Act, source: ClipSource, length: int, actor: str
) -> list[Clip]:
    """Cut one episode of each environment into clips of `length` steps.

    Args:
        env: gives measures and states.
        act: chooses the actions.
        source: of the environment's batch.
        length: of a clip [control steps].
        actor: who acts, in words.

    Raises:
        UserError: episodes are shorter than a clip.
    """
    horizon = env.batch.horizon
    if length > horizon:
        raise UserError(
            f"a clip of {length} steps is longer than an episode of {horizon}"
        )
    state, steps = env.reset(), []
    for _ in range(horizon):
        state["action"] = act(state)
        step, state = env.step_and_maybe_reset(state)
        steps.append(step)
    return cut_clips(torch.stack(steps, 1), length, source, actor)
