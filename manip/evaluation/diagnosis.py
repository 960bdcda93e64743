"""Diagnose a run from its training metrics: is it stuck, and at which milestone?"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

Row = Mapping[str, float]
"""A row of metrics.csv: column -> number."""

USUAL = 0.5
"""A milestone that this share of the training episodes reaches counts as learned."""

RISE = 0.05
"""A milestone's rate rises when it is this much above that of its last rise."""

PATIENCE = 1 / 3
"""Share of a run after which a rate that has not risen counts as stuck."""

LEAST_STEPS = 5_000
"""Control steps within which a rate need not rise: exploration has hardly begun."""

LOST = 0.5
"""A rate below this share of its highest value has collapsed."""

PAGE = "docs/troubleshooting.md"


@dataclass(frozen=True)
class Diagnosis:
    """What keeps a run from success.

    Attributes:
        kind: stuck: the milestone after the last that most episodes reach has not been
            reached more often for some time; drops: most episodes succeed, but do not
            end in success; collapsed: a rate that was high is low again.
        milestone: the milestone, or the measure of success.
        steps: control steps since its rate last rose.
        rate: share of the recent training episodes that reached it.
    """

    kind: Literal["stuck", "drops", "collapsed"]
    milestone: str
    steps: int
    rate: float

    @property
    def words(self) -> str:
        """The diagnosis in a line, with the page that leads to the cause."""
        return f"{self._finding()}: see {PAGE}"

    def _finding(self) -> str:
        if self.kind == "stuck":
            return f"stuck at {self.milestone} for {_thousands(self.steps)} steps"
        if self.kind == "drops":
            return f"succeeds, but {self.milestone} is {self.rate:.0%}"
        return f"{self.milestone} has fallen to {self.rate:.0%}"


def diagnose(
    rows: Sequence[Row], milestones: Sequence[str], total_steps: int
) -> Diagnosis | None:
    """Diagnose a run from the `train/` columns of its rows.

    Args:
        rows: of metrics.csv, up to the present; a row may lack columns.
        milestones: names of the task's milestones, in order.
        total_steps: control steps of the whole run.

    Returns:
        the first of these that holds, None for a run that goes well: a rate has
        collapsed; the milestone after the last one learned is stuck; success is not
        held.
    """
    rows = [row for row in rows if "train/success_held" in row]
    if not rows:
        return None
    patience = max(PATIENCE * total_steps, LEAST_STEPS)
    return next(_findings(rows, milestones, patience), None)


def _findings(
    rows: Sequence[Row], milestones: Sequence[str], patience: float
) -> Iterator[Diagnosis]:
    now = {name: rows[-1][f"train/{name}"] for name in _names(milestones)}
    for name, rate in now.items():
        highest = max(row[f"train/{name}"] for row in rows)
        if highest >= USUAL and rate < LOST * highest:
            yield Diagnosis("collapsed", name, _since_rise(rows, name), rate)
    missing = _missing(now, milestones)
    if missing and (steps := _since_rise(rows, missing[0])) >= patience:
        yield Diagnosis("stuck", missing[0], steps, now[missing[0]])
    dropped = now["success_once"] >= USUAL > now["success_held"]
    if dropped and (steps := _since_rise(rows, "success_held")) >= patience:
        yield Diagnosis("drops", "success_held", steps, now["success_held"])


def _missing(now: Row, milestones: Sequence[str]) -> Sequence[str]:
    """The milestones after the last learned one: a task can succeed without others."""
    learned = [i for i, name in enumerate(milestones) if now[name] >= USUAL]
    return milestones[max(learned, default=-1) + 1 :]


def _names(milestones: Sequence[str]) -> list[str]:
    return list(dict.fromkeys((*milestones, "success_once", "success_held")))


def _since_rise(rows: Sequence[Row], name: str) -> int:
    """Control steps between the last rise of a rate and the last row."""
    column = f"train/{name}"
    level, risen = rows[0][column], 0.0
    for row in rows:
        if row[column] >= level + RISE:
            level, risen = row[column], row["env_steps"]
    return int(rows[-1]["env_steps"] - risen)


def _thousands(steps: int) -> str:
    """12 k for 12,345; 1.2 k for 1,234; 123."""
    if steps < 1000:
        return str(steps)
    return f"{steps / 1000:.{1 if steps < 10_000 else 0}f} k"
