"""Counters and results of a run, as its checkpoints hold them."""

from dataclasses import asdict, dataclass, field
from math import isfinite
from typing import Any

from manip.errors import MOST, UserError
from manip.evaluation.episodes import Episode
from manip.io.dataclass_values import build
from manip.training.run_logs import renamed


@dataclass
class RunState:
    """What a run has done so far, besides what its agent and environments hold.

    Attributes:
        env_steps: control steps taken, all environments together.
        extra_steps: control steps by which the run is longer than --steps, because it
            was to reach --until.
        seconds: wall time of training and evaluation [s].
        cpu_seconds: computing time of all threads, without evaluations [s].
        best: success_held and return of the best evaluation; empty before the first.
        lost_updates: updates that were lost to gradients or losses that are not finite.
        learned: latest values that the agent's updates returned.
        episodes: recent finished training episodes.
        reward_terms: means of the raw reward terms of recent rollouts.
        rows: rows of metrics.csv.
    """

    env_steps: int = 0
    extra_steps: int = 0
    seconds: float = 0.0
    cpu_seconds: float = 0.0
    best: list[float] = field(default_factory=list)
    lost_updates: int = 0
    learned: dict[str, float] = field(default_factory=dict)
    episodes: list[Episode] = field(default_factory=list)
    reward_terms: list[list[float]] = field(default_factory=list)
    rows: list[dict[str, float]] = field(default_factory=list)

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)


def run_state(values: Any, milestones: int, terms: int) -> RunState:
    """The state of plain values, each checked.

    Args:
        values: what `RunState.to_dict` returned.
        milestones: number of the task's milestones.
        terms: number of its reward terms.

    Raises:
        UserError: a value has another type, or is out of its range.
    """
    if not isinstance(values, dict) or not isinstance(values.get("episodes"), list):
        raise UserError("the run's state must be a mapping with a list of episodes")
    episodes = [episode_of(episode, milestones) for episode in values["episodes"]]
    values = {"extra_steps": 0} | values  # older checkpoints do not have it
    state = build(RunState, values | {"episodes": episodes})
    state.rows = [renamed(row) for row in state.rows]
    missing = RunState().to_dict().keys() - values.keys()
    _require(not missing, f"{', '.join(sorted(missing))} is missing")
    _check_numbers(state)
    _require(len(state.best) in (0, 2), "best must be two numbers")
    _check_rows(state)
    lengths = {len(means) for means in state.reward_terms}
    _require(lengths <= {terms}, f"reward_terms must be lists of {terms} numbers")
    return state


def episode_of(values: Any, milestones: int) -> Episode:
    """The episode of plain values, each checked."""
    episode = build(Episode, values)
    _require(
        len(episode.milestones) == milestones, f"an episode has {milestones} milestones"
    )
    return episode


def _check_numbers(state: RunState) -> None:
    for name in ("env_steps", "extra_steps", "lost_updates", "seconds", "cpu_seconds"):
        value = getattr(state, name)
        _require(
            isfinite(value) and 0 <= value <= MOST,
            f"{name} must be from 0 to {MOST}, not {value}",
        )


def _check_rows(state: RunState) -> None:
    steps = [row.get("env_steps", -1) for row in state.rows]
    _require(
        all(isinstance(step, int) for step in steps)
        and steps == sorted(steps)
        and all(0 <= step <= state.env_steps for step in steps),
        f"rows must have growing env_steps up to {state.env_steps}",
    )


def _require(holds: bool, message: str) -> None:
    if not holds:
        raise UserError(message)
