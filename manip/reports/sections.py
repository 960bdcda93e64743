"""Sections of the report's page: the numbers and words about one run."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup

from manip.envs.external_task import simulator_of
from manip.evaluation.diagnosis import PAGE, diagnose
from manip.evaluation.episode_table import motion_summary
from manip.evaluation.episodes import Episode
from manip.evaluation.report import summarise
from manip.reports.commands import changed_options, evaluate_commands, train_command
from manip.reports.funnel import Grade, Stage, describe, funnel, grade
from manip.reports.recorded_episodes import RecordedEpisodes
from manip.reports.replays import Replays, outcome
from manip.reports.run_record import RunRecord
from manip.reports.stored_results import (
    StoredEvaluation,
    StoredRobustness,
    stored_evaluation,
    stored_robustness,
)
from manip.reports.training_charts import learner_charts, training_charts
from manip.training.config import to_dict
from manip.training.recipes import recipe


@dataclass(frozen=True)
class EpisodeRow:
    """A row of the table of episodes.

    Attributes:
        reached: last milestone, in their order, that the episode reached.
        success_seconds: time of the first success [s]; None without one.
    """

    number: int
    outcome: str
    reached: str
    success_seconds: float | None
    total_reward: float
    replay: bool


@dataclass(frozen=True)
class TermRow:
    """A reward term: its weights, and its mean raw value in a step of an episode."""

    name: str
    paid: float
    usual: float
    solved: float | None
    others: float | None


@dataclass(frozen=True)
class MotionRow:
    """A measure of the robot's motion: its median over episodes, and its unit."""

    name: str
    meaning: str
    solved: str
    others: str


MOTION = {
    "speed": ("largest joint speed", "share of the arm's limit", 100, " %"),
    "torque": ("largest joint torque", "share of the arm's limit", 100, " %"),
    "jerk": ("largest joint jerk", "share of the arm's limit", 100, " %"),
    "action_change": ("change of the action", "mean of a control step", 1, ""),
    "hand_tilt": ("largest tilt of the hand", "from straight down", 180 / np.pi, "°"),
    "self_contact": ("arm touches itself", "share of the steps", 100, " %"),
}
"""Measure of `motion_summary` -> its name, what it is, scale and unit."""


@dataclass(frozen=True)
class RunSection:
    """What the page shows of one run."""

    record: RunRecord
    result: dict[str, Any]
    episodes: list[EpisodeRow]
    seed: int
    backend: str
    stages: list[Stage]
    grade: Grade
    sentences: list[str]
    terms: list[TermRow]
    motion: list[MotionRow]
    stored: StoredEvaluation | None
    robustness: StoredRobustness | None
    charts: list[Markup]
    learner: list[Markup]
    train: str | None
    evaluate: str
    options: list[tuple[str, str, bool]]
    replays: Replays | None

    @property
    def failures(self) -> int:
        """Number of episodes without success_held."""
        return sum(row.outcome != "solved" for row in self.episodes)


def make_section(
    record: RunRecord, played: RecordedEpisodes, replays: Replays | None
) -> RunSection:
    """Summarise a run and its episodes."""
    episodes, names = played.episodes, record.task.milestone_names
    stages = funnel(episodes, names)
    usual = record.task.weights[record.reward_set]
    settings = played.settings
    return RunSection(
        record=record,
        result=summarise(episodes, names),
        episodes=_rows(record, episodes, replays),
        seed=settings.seed,
        backend=simulator_of(settings.backend, record.policy.card.task),
        stages=stages,
        grade=grade(stages),
        sentences=[
            *describe(stages, len(episodes), record.reward_weights, usual),
            *_advice(record, stages),
        ],
        terms=_terms(record, played, usual),
        motion=_motion(episodes, record.policy.card.robot),
        stored=stored_evaluation(record.path),
        robustness=stored_robustness(record.path),
        charts=training_charts(record),
        learner=learner_charts(record),
        train=train_command(record.config) if record.config else None,
        evaluate=evaluate_commands(record, settings, _first_shown(episodes)),
        options=_options(record),
        replays=replays,
    )


def _first_shown(episodes: Sequence[Episode]) -> int:
    """Number of the first episode without success_held, or of the first of all."""
    return next((e.index for e in episodes if not e.success_held), 0)


def _advice(record: RunRecord, stages: Sequence[Stage]) -> list[str]:
    """What the training metrics say, or where to read on if the task is not solved."""
    steps = record.config.steps if record.config else record.policy.card.env_steps
    finding = diagnose(record.rows, record.task.milestone_names, steps)
    if finding:
        return [f"At the end of the training: {finding.words}."]
    return [] if grade(stages) == "good" else [f"What to do: see {PAGE}."]


def _rows(
    record: RunRecord, episodes: Sequence[Episode], replays: Replays | None
) -> list[EpisodeRow]:
    shown = {line["number"] for line in replays.timelines} if replays else set()
    dt = 1 / record.policy.card.control_freq
    return [
        EpisodeRow(
            number=episode.index,
            outcome=outcome(episode),
            reached=_reached(record.task.milestone_names, episode),
            success_seconds=episode.first_success and episode.first_success * dt,
            total_reward=episode.total_reward,
            replay=episode.index in shown,
        )
        for episode in episodes
    ]


def _reached(names: Sequence[str], episode: Episode) -> str:
    pairs = zip(names, episode.milestones, strict=True)
    reached = [name for name, flag in pairs if flag]
    return reached[-1] if reached else "none"


def _terms(
    record: RunRecord, played: RecordedEpisodes, usual: Mapping[str, float]
) -> list[TermRow]:
    """The terms that the episodes measured: those of the evaluation's reward set."""
    recorder = played.recorder
    if recorder is None:
        return []
    means = np.stack([recorder.recorded(e).terms.mean(0) for e in played.episodes])
    solved = np.array([episode.success_held for episode in played.episodes])
    return [
        TermRow(
            name=name,
            paid=record.reward_weights.get(name, 0.0),
            usual=usual.get(name, 0.0),
            solved=_mean(means[solved, index]),
            others=_mean(means[~solved, index]),
        )
        for index, name in enumerate(recorder.batch.reward_names)
    ]


def _motion(episodes: Sequence[Episode], arm: str) -> list[MotionRow]:
    """Medians of solved and of other episodes; none if no motion is recorded."""
    groups = [
        [e for e in episodes if e.success_held is lasting] for lasting in (True, False)
    ]
    solved, others = (motion_summary(group, arm) or {} for group in groups)
    return [
        MotionRow(
            name,
            meaning,
            _scaled(solved.get(key), scale, unit),
            _scaled(others.get(key), scale, unit),
        )
        for key, (name, meaning, scale, unit) in MOTION.items()
        if key in solved or key in others
    ]


def _scaled(value: float | None, scale: float, unit: str) -> str:
    if value is None:
        return "–"
    number = scale * value
    return f"{number:.0f}{unit}" if number >= 10 else f"{number:.2g}{unit}"


def _mean(values: np.ndarray) -> float | None:
    return float(values.mean()) if len(values) else None


def _options(record: RunRecord) -> list[tuple[str, str, bool]]:
    """Name, value and whether it differs from the recipe, of each option."""
    if record.config is None:
        return []
    config = record.config
    chosen = config.task, config.algo, config.robot, config.controller, config.observe
    changed = {name for name, _ in changed_options(config, recipe(*chosen))}
    return [
        (name, shown_value(value), name in changed)
        for name, value in flat_options(record).items()
    ]


def flat_options(record: RunRecord) -> dict[str, Any]:
    """Option -> value, nested ones as agent.gamma; without the folder."""
    if record.config is None:
        return {}
    flat: dict[str, Any] = {}
    for name, value in to_dict(record.config).items():
        nested = value.items() if isinstance(value, dict) else ()
        flat |= {f"{name}.{key}": item for key, item in nested} or {name: value}
    return {
        name: value for name, value in flat.items() if name not in ("out", "resume")
    }


def shown_value(value: Any) -> str:
    """An option's value as text."""
    if isinstance(value, list | tuple):
        return " ".join(map(str, value)) or "none"
    return "none" if value is None else str(value)
