"""The funnel of an evaluation: how far its episodes get, and where they are lost."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Literal

from manip.evaluation.episodes import Episode
from manip.evaluation.statistics import Rate, success_rate

SOLVED, HALF = 0.9, 0.5
"""Shares of episodes with success_held from which a policy is called good, or fair."""

Grade = Literal["good", "fair", "poor"]


@dataclass(frozen=True)
class Stage:
    """A milestone or a measure of success, and the episodes that reached it.

    Attributes:
        step: median over these of the first step in which it was reached; None for a
            measure of success, or if no steps are recorded.
    """

    name: str
    reached: int
    rate: Rate
    step: float | None = None


def funnel(episodes: Sequence[Episode], milestones: Sequence[str]) -> list[Stage]:
    """The milestones in order, success in one step or more, and success that lasts.

    success_once is left out where the last milestone is the same.
    """
    flags = {
        name: [episode.milestones[index] for episode in episodes]
        for index, name in enumerate(milestones)
    }
    once = [episode.success_once for episode in episodes]
    if once not in flags.values():
        flags["success_once"] = once
    flags["success_held"] = [episode.success_held for episode in episodes]
    steps = _median_steps(episodes, milestones)
    return [
        Stage(name, sum(flag), success_rate(flag), steps.get(name))
        for name, flag in flags.items()
    ]


def _median_steps(
    episodes: Sequence[Episode], milestones: Sequence[str]
) -> dict[str, float]:
    rows = [episode.details.milestone_steps for episode in episodes if episode.details]
    columns = zip(milestones, zip(*rows, strict=True), strict=bool(rows))
    known = {name: [s for s in steps if s is not None] for name, steps in columns}
    return {name: float(median(steps)) for name, steps in known.items() if steps}


def grade(stages: Sequence[Stage]) -> Grade:
    """How good the policy is, by its success_held."""
    rate = stages[-1].rate.rate
    return "good" if rate >= SOLVED else "fair" if rate >= HALF else "poor"


def describe(
    stages: Sequence[Stage],
    episodes: int,
    paid: Mapping[str, float],
    usual: Mapping[str, float],
) -> list[str]:
    """Say in sentences what the funnel shows.

    Args:
        stages: of `funnel`.
        episodes: their number.
        paid: reward term -> weight in the run's training.
        usual: reward term -> weight of the task.
    """
    lines = [_result(stages[-1], episodes)]
    if stages[-1].reached < episodes:
        lines.append(_loss(stages, episodes))
    lines += [
        f"The reward term {name} had weight 0 in training (the task's own weight is "
        f"{usual[name]:g}): nothing was paid for it."
        for name, weight in paid.items()
        if not weight and usual.get(name)
    ]
    return lines


def _result(lasting: Stage, episodes: int) -> str:
    if lasting.reached == episodes:
        return f"All {episodes} episodes end in success that lasts (success_held)."
    return (
        f"{lasting.reached} of {episodes} episodes end in success that lasts "
        "(success_held)."
    )


def _loss(stages: Sequence[Stage], episodes: int) -> str:
    """Describe the step between two stages at which most episodes are lost."""
    before = [("the start", episodes), *((s.name, s.reached) for s in stages[:-1])]
    losses = [
        count - stage.reached for (_, count), stage in zip(before, stages, strict=True)
    ]
    worst = max(range(len(stages)), key=losses.__getitem__)
    (name, count), stage = before[worst], stages[worst]
    if stage.name == "success_held":
        return (
            f"Most losses come at the end: {count} episodes reach {name}, and "
            f"{stage.reached} are successful in each of their last 10 steps."
        )
    of = f"of {count} episodes that reach {name}" if worst else f"of {count} episodes"
    return f"Most losses come at {stage.name}: {of}, {stage.reached} get there."
