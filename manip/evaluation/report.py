"""The result of an evaluation: one record, as JSON and as a table."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from rich.table import Table
from rich.text import Text

from manip.envs.external_task import simulator_of
from manip.evaluation.episodes import Episode
from manip.evaluation.statistics import Mean, Rate, mean_over_episodes, success_rate
from manip.io.printable import printable

SUCCESS = ("success_once", "success_at_end", "success_held")
"""Measures of success: in one step or more, in the last, in the last ten."""


MOTION = {
    "speed": "peak joint speed / limit",
    "torque": "peak joint torque / limit",
    "jerk": "peak joint jerk / limit",
    "action_change": "change of action per step",
    "hand_tilt": "largest hand tilt [rad]",
    "self_contact": "steps with self-contact",
}
"""Entry of `Evaluation.motion` -> its words in the table."""


@dataclass(frozen=True)
class EvaluatedPolicy:
    """Which policy was evaluated, in which episodes.

    Attributes:
        task, robot, algo: of the policy's card.
        env: "stock", "native" or "warp".
        fidelity: physics of the episodes.
        episodes: their number; of each level, if several are compared.
        seed: of their random streams.
    """

    task: str
    robot: str
    algo: str
    env: str
    fidelity: str
    episodes: int
    seed: int

    def to_json(self) -> str:
        """Indented JSON with all fields."""
        return json.dumps(asdict(self), indent=2) + "\n"


@dataclass(frozen=True)
class Evaluation(EvaluatedPolicy):
    """The result of an evaluation of one policy; `to_json` is the text of eval.json.

    Attributes:
        purpose: of the random streams of the episodes.
        success: success_once, success_at_end, success_held -> rate with its Wilson
            95 % interval, which covers episodes, not training seeds.
        return_mean: mean over episodes of the sum of rewards.
        milestones: milestone -> share of episodes that reached it.
        first_success_median: control steps until the first success, over the episodes
            that have one; None if none has.
        seconds: wall time of the evaluation.
        taste: name of the taste that was measured; None if none was.
        taste_penalty: mean penalty of a step, a mean over episodes.
        looks: suite of looks of the images; None for robosuite's own look.
        image_quality: of the images: exact, lean, or None if the policy sees none.
        motion: see `motion_summary`; None if no motion was recorded.
    """

    purpose: str
    env_steps_trained: int
    success: dict[str, Rate]
    return_mean: float
    milestones: dict[str, float]
    first_success_median: float | None
    seconds: float
    versions: dict[str, str]
    taste: str | None = None
    taste_penalty: Mean | None = None
    looks: str | None = None
    image_quality: str | None = None
    motion: dict[str, float] | None = None


def summarise(episodes: Sequence[Episode], milestones: Sequence[str]) -> dict[str, Any]:
    """Statistics of episodes, under the names of the fields of `Evaluation`."""
    shares = np.array([episode.milestones for episode in episodes]).mean(0)
    first = [e.first_success for e in episodes if e.first_success is not None]
    penalties = [e.penalty for e in episodes if e.penalty is not None]
    return {
        "success": {
            measure: success_rate([getattr(episode, measure) for episode in episodes])
            for measure in SUCCESS
        },
        "return_mean": float(np.mean([e.total_reward for e in episodes])),
        "milestones": dict(zip(milestones, map(float, shares), strict=True)),
        "first_success_median": float(np.median(first)) if first else None,
        "taste_penalty": mean_over_episodes(penalties) if penalties else None,
    }


def table(result: Evaluation) -> Table:
    """The result as a table; text of the policy's card is printed without markup."""
    simulator = simulator_of(result.env, result.task)
    parts = [result.task, result.robot, result.algo, simulator]
    parts += [result.looks] if result.looks else []
    title = Text(printable(" · ".join(parts)), style="bold")
    columns = Table(title=title)
    columns.add_column("measure", overflow="fold")
    columns.add_column("value", justify="right", overflow="fold")
    columns.add_column("95 % interval", justify="right", overflow="fold")
    for row in _rows(result):
        columns.add_row(*(Text(printable(cell)) for cell in row))
    return columns


def _rows(result: Evaluation) -> list[tuple[str, str, str]]:
    rows = [
        (measure, f"{rate.rate:.1%}", f"{rate.low:.1%} - {rate.high:.1%}")
        for measure, rate in result.success.items()
    ]
    if penalty := result.taste_penalty:
        interval = f"{penalty.low:.3f} - {penalty.high:.3f}"
        rows.append((f"{result.taste} penalty", f"{penalty.mean:.3f}", interval))
    rows += [(f"reached {m}", f"{s:.1%}", "") for m, s in result.milestones.items()]
    rows.append(("mean return", f"{result.return_mean:.1f}", ""))
    if result.first_success_median is not None:
        step = f"step {result.first_success_median:g}"
        rows.append(("median first success", step, ""))
    rows += [(MOTION[n], f"{v:.3g}", "") for n, v in (result.motion or {}).items()]
    rows.append(("episodes, seed", f"{result.episodes}, {result.seed}", ""))
    rows.append(("wall time", f"{result.seconds:.1f} s", ""))
    return rows
