"""Run the episodes of a report, and record what their replays show."""

from dataclasses import dataclass, replace

from manip.agents.policy import Policy
from manip.envs.external_task import ExternalTask
from manip.envs.task import Task
from manip.evaluation.episode_recording import Progress, StateRecorder
from manip.evaluation.episodes import Episode
from manip.evaluation.runners import (
    EpisodeSettings,
    evaluate_policy,
    make_env,
    run_settings,
)


@dataclass(frozen=True)
class RecordedEpisodes:
    """Episodes of one policy.

    Attributes:
        settings: of the episodes.
        episodes: the outcomes, in order of their number.
        recorder: of their steps; None if they did not run on the batch engine.
    """

    settings: EpisodeSettings
    episodes: list[Episode]
    recorder: StateRecorder | None = None


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
    recorder = StateRecorder(env, progress)
    results = run_settings(env, policy, settings, episodes, recorder)
    results = sorted(results, key=lambda episode: episode.index)
    return RecordedEpisodes(settings, results, recorder)


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
