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

Progress = Callable[[float], None]
"""Called with the share of the episodes that has been simulated."""


@dataclass(frozen=True)
class RecordedEpisode:
    """One episode: its outcome, and the T states before its steps.

    Attributes:
        episode: the outcome.
        model: builds the MuJoCo model that draws it.
        poses: qpos [T, nq].
        success: [T] bool.
        milestones: [T, M] bool.
        terms: [T, K], the raw reward terms.
        images: [T] lists of the images that the policy saw, uint8 [S, S, 3 k].
    """

    episode: Episode
    model: Callable[[], Any]
    poses: Array
    success: Array
    milestones: Array
    terms: Array
    images: list[list[Array]]


class StateRecorder:
    """Record the states of N environments; a callback of `run_episodes`.

    Args:
        env: the environments, native or stock.
        progress: called with the share of an episode's time that has passed.
    """

    def __init__(self, env: TaskEnv, progress: Progress = lambda _: None) -> None:
        self.batch, self._progress = env.batch, progress
        self._steps: list[dict[str, Array]] = []
        self._images: list[list[Array]] = []
        self._models: list[Callable[[], Any]] = []

    def __call__(self, state: TensorDictBase) -> None:
        """Record the present state of all environments."""
        if not self._models:
            self._models = [self._model(i) for i in range(self.batch.num_envs)]
        now = {
            "poses": self.batch.read()["qpos"],
            "success": state["success"].squeeze(-1).numpy(),
            "milestones": state["milestones"].numpy(),
            "terms": state["reward_terms"].numpy(),
        }
        self._steps.append({name: values.copy() for name, values in now.items()})
        parts = self.batch.cameras.parts
        self._images.append([state[part.name].numpy() for part in parts])
        self._progress(min(1.0, len(self._steps) / self.batch.horizon))

    def recorded(self, episode: Episode) -> RecordedEpisode:
        """The first episode of an environment, which has ended."""
        env_id, steps = episode.env_id, self._steps[: episode.steps]
        images = self._images[: episode.steps]
        return RecordedEpisode(
            episode=episode,
            model=self._models[env_id],
            **{n: np.stack([step[n][env_id] for step in steps]) for n in steps[0]},
            images=[[image[env_id] for image in row] for row in images],
        )

    def _model(self, env_id: int) -> Callable[[], Any]:
        if isinstance(self.batch, NativeBatch):
            state = self.batch.engine.states[env_id].copy()
            return partial(self.batch.engine.visual_model, state)
        model = self.batch.visual_model(env_id)
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
