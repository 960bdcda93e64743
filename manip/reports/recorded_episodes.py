"""Run the episodes of a report, and record what their replays show."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from tensordict import TensorDictBase

from manip.agents.policy import Policy
from manip.envs.backends.native_batch import NativeBatch
from manip.envs.external_task import ExternalTask
from manip.envs.task import Task
from manip.evaluation.episodes import Episode
from manip.evaluation.runners import (
    EpisodeSettings,
    evaluate_policy,
    make_env,
    run_settings,
)

Array = np.ndarray

Progress = Callable[[float], None]
"""Called with the share of a run's episodes that has been simulated."""


@dataclass(frozen=True)
class RecordedSteps:
    """T control steps of N episodes on the batch engine.

    Attributes:
        batch: the environments that ran them.
        first: [N, S], rows of the engine at the start.
        qpos: [T, N, nq], before each step. What follows an episode's end is of others.
        success: [T, N] bool.
        milestones: [T, N, M] bool.
        terms: [T, N, K], the raw reward terms.
    """

    batch: NativeBatch
    first: Array
    qpos: Array
    success: Array
    milestones: Array
    terms: Array

    def states(self, episode: Episode) -> Array:
        """[steps, nq]: qpos before each step of an episode."""
        states: Array = self.qpos[: episode.steps, episode.env_id]
        return states

    def model(self, episode: Episode) -> Any:
        """MuJoCo model that draws an episode."""
        return self.batch.engine.visual_model(self.first[episode.env_id])


@dataclass(frozen=True)
class RecordedEpisodes:
    """Episodes of one policy.

    Attributes:
        settings: of the episodes.
        episodes: the outcomes, in order of their number.
        steps: None if they did not run on the batch engine.
    """

    settings: EpisodeSettings
    episodes: list[Episode]
    steps: RecordedSteps | None = None


class _Recorder:
    """Copies the state of the environments before every step."""

    def __init__(self, batch: NativeBatch, progress: Progress) -> None:
        self._batch, self._progress = batch, progress
        self.first = np.empty(0)
        self.columns: dict[str, list[Array]] = {
            name: [] for name in ("qpos", "success", "milestones", "terms")
        }

    def __call__(self, state: TensorDictBase) -> None:
        states = self._batch.engine.states
        steps = len(self.columns["qpos"])
        if not steps:
            self.first = states.copy()
        now = {
            "qpos": states[:, : self._batch.scene.nq].copy(),
            "success": state["success"].squeeze(-1).numpy().copy(),
            "milestones": state["milestones"].numpy().copy(),
            "terms": state["reward_terms"].numpy().copy(),
        }
        for name, values in now.items():
            self.columns[name].append(values)
        self._progress(min(1.0, steps / self._batch.horizon))


def record_episodes(
    policy: Policy,
    task: Task,
    episodes: int,
    seed: int,
    progress: Progress = lambda _: None,
) -> RecordedEpisodes:
    """Run episodes on the batch engine, in robosuite's own physics.

    Tasks of other libraries are stepped by these, and are not recorded.

    Raises:
        UserError: the task lacks a part that the policy observes.
    """
    card = policy.card
    settings = EpisodeSettings(
        task=task,
        robot=card.robot_config,
        observation=card.observation,
        cameras=card.cameras,
        episodes=episodes,
        seed=seed,
        backend="native",
        details=True,
    )
    if isinstance(task, ExternalTask):
        return _counted(policy, replace(settings, backend="stock"), progress)
    env = make_env(settings, episodes)
    assert isinstance(env.batch, NativeBatch)
    recorder = _Recorder(env.batch, progress)
    results = run_settings(env, policy, settings, episodes, recorder)
    results = sorted(results, key=lambda episode: episode.index)
    columns = {name: np.stack(rows) for name, rows in recorder.columns.items()}
    steps = RecordedSteps(env.batch, recorder.first, **columns)
    return RecordedEpisodes(settings, results, steps)


def _counted(
    policy: Policy, settings: EpisodeSettings, progress: Progress
) -> RecordedEpisodes:
    """Run the episodes of another library."""
    ended = 0

    def advance(count: int) -> None:
        nonlocal ended
        ended += count
        progress(ended / settings.episodes)

    return RecordedEpisodes(settings, evaluate_policy(policy, settings, advance))
