"""What an evaluation says: one record, as JSON and as a table."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from rich.table import Table

from manip.envs.external_task import library_of
from manip.evaluation.episodes import Episode
from manip.evaluation.statistics import Rate, success_rate


@dataclass(frozen=True)
class Evaluation:
    """The result of an evaluation; `to_json` is what `eval.json` holds.

    success: {once, success_at_end, held} -> rate with its Wilson 95 % interval.
    return_mean: mean sum of shaped rewards an episode. milestones: milestone -> share of
    episodes that reached it. first_success_median: control steps, if any succeeded.
    seconds: wall time of the evaluation.
    """

    task: str
    robot: str
    algo: str
    env: str
    fidelity: str
    episodes: int
    seed: int
    env_steps_trained: int
    success: dict[str, Rate]
    return_mean: float
    milestones: dict[str, float]
    first_success_median: float | None
    seconds: float
    versions: dict[str, str]

    def to_json(self) -> str:
        """Indented JSON with the fields above."""
        return json.dumps(asdict(self), indent=2) + "\n"


def summarise(episodes: Sequence[Episode], milestones: Sequence[str]) -> dict[str, Any]:
    """The statistics of an `Evaluation`, under the names of its fields."""
    reached = np.array([episode.milestones for episode in episodes]).mean(0)
    first = [e.first_success for e in episodes if e.first_success is not None]
    return {
        "success": {
            kind: success_rate([getattr(episode, kind) for episode in episodes])
            for kind in ("success_once", "success_at_end", "success_held")
        },
        "return_mean": float(np.mean([e.total_reward for e in episodes])),
        "milestones": dict(zip(milestones, map(float, reached), strict=True)),
        "first_success_median": float(np.median(first)) if first else None,
    }


def table(result: Evaluation) -> Table:
    """The result for people to read."""
    where = f"{result.env} {library_of(result.task)}"
    title = f"{result.task} · {result.robot} · {result.algo} · {where}"
    shown = Table(title=title, title_style="bold")
    shown.add_column("measure")
    shown.add_column("value", justify="right")
    shown.add_column("95 % interval", justify="right")
    for kind, rate in result.success.items():
        interval = f"{rate.low:.1%} - {rate.high:.1%}"
        shown.add_row(f"success {kind.replace('_', ' ')}", f"{rate.rate:.1%}", interval)
    for stage, share in result.milestones.items():
        shown.add_row(f"reached {stage}", f"{share:.1%}", "")
    shown.add_row("mean return", f"{result.return_mean:.1f}", "")
    if result.first_success_median is not None:
        shown.add_row(
            "median first success", f"step {result.first_success_median:g}", ""
        )
    shown.add_row("episodes, first seed", f"{result.episodes}, {result.seed}", "")
    shown.add_row("wall time", f"{result.seconds:.1f} s", "")
    return shown
