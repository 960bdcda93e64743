"""Record the states of episodes while they run, to draw them later."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from tensordict import TensorDictBase

from manip.envs.adapters.torchrl import TaskEnv
from manip.envs.backends.native_batch import NativeBatch
from manip.evaluation.episodes import Episode, Policy
from manip.evaluation.runners import (
    ActsInBatch,
    EpisodeSettings,
    make_env,
    run_settings,
)

Array = np.ndarray


@dataclass(frozen=True)
class RecordedEpisode:
    """One episode: its outcome, and the T states before its steps.

    Attributes:
        episode: the outcome.
        model: builds the MuJoCo model that draws it.
        poses: qpos [T, nq].
        success: [T] bool.
        images: [T] lists of the images that the policy saw, uint8 [S, S, 3 k].
    """

    episode: Episode
    model: Callable[[], Any]
    poses: Array
    success: Array
    images: list[list[Array]]


class StateRecorder:
    """Record the states of N environments; a callback of `run_episodes`.

    Args:
        env: the environments, native or stock.
    """

    def __init__(self, env: TaskEnv) -> None:
        self._batch = env.batch
        self._poses: list[Array] = []
        self._success: list[Array] = []
        self._images: list[list[Array]] = []
        self._models: list[Callable[[], Any]] = []

    def __call__(self, state: TensorDictBase) -> None:
        """Record the present state of all environments."""
        if not self._models:
            self._models = [self._model(i) for i in range(self._batch.num_envs)]
        self._poses.append(self._batch.read()["qpos"].copy())
        self._success.append(state["success"].squeeze(-1).numpy().copy())
        parts = self._batch.cameras.parts
        self._images.append([state[part.name].numpy() for part in parts])

    def recorded(self, episode: Episode) -> RecordedEpisode:
        """The first episode of an environment, which has ended."""
        env_id, steps = episode.env_id, slice(episode.steps)
        return RecordedEpisode(
            episode=episode,
            model=self._models[env_id],
            poses=np.stack(self._poses[steps])[:, env_id],
            success=np.stack(self._success[steps])[:, env_id],
            images=[[image[env_id] for image in row] for row in self._images[steps]],
        )

    def _model(self, env_id: int) -> Callable[[], Any]:
        if isinstance(self._batch, NativeBatch):
            state = self._batch.engine.states[env_id].copy()
            return partial(self._batch.engine.visual_model, state)
        model = self._batch.visual_model(env_id)
        return lambda: model


def first_state(settings: EpisodeSettings) -> RecordedEpisode:
    """The first state of the first episode, to draw it before the episodes run.

    Raises:
        UserError: another library steps the task, so that it cannot be drawn.
    """
    env = make_env(settings)
    env.batch.visual_model(0)
    recorder = StateRecorder(env)
    recorder(env.reset())
    begun = Episode(0, 1, 0.0, False, False, False, None, ())
    return recorder.recorded(begun)


def record(
    policy: Policy | ActsInBatch, settings: EpisodeSettings
) -> list[RecordedEpisode]:
    """Run the episodes of the settings, in their order, and record them.

    Natively they run side by side in one batch, else one after the other.
    """
    if settings.backend != "stock":
        env = make_env(settings, settings.episodes)
        return _record(env, policy, settings, settings.episodes)
    env, recorded = make_env(settings), []
    for index in range(settings.first, settings.first + settings.episodes):
        env.batch.restart(episode=index)
        (one,) = _record(env, policy, settings, 1)
        recorded.append(replace(one, episode=replace(one.episode, index=index)))
    return recorded


def _record(
    env: TaskEnv, policy: Policy | ActsInBatch, settings: EpisodeSettings, number: int
) -> list[RecordedEpisode]:
    recorder = StateRecorder(env)
    episodes: Sequence[Episode] = run_settings(env, policy, settings, number, recorder)
    in_order = sorted(episodes, key=lambda episode: episode.index)
    return [recorder.recorded(episode) for episode in in_order]
