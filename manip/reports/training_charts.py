"""Charts of a run's metrics.csv, and of several runs over each other."""

from collections.abc import Iterable, Mapping, Sequence

from markupsafe import Markup

from manip.reports.line_chart import Axis, Line, line_chart
from manip.reports.run_record import RunRecord

SUCCESS = ("success_once", "success_at_end", "success_held")

KINDS = (
    ("eval", "evaluation"),
    ("curve", "light evaluation"),
    ("train", "training episodes"),
)
"""First part of a column of metrics.csv, and where its numbers come from."""

EVALUATED = ("eval/success_held", "curve/success_held")
"""Columns of which a row with an evaluation has one."""

_STEPS = Axis("control steps [thousand]", low=0.0, scale=1e-3)
_SHARE = Axis("", low=0.0, high=100.0, scale=100.0, unit=" %")
_VALUE = Axis("")


def training_charts(record: RunRecord) -> list[Markup]:
    """Success, return, milestones and reward terms of one run, those that it has."""
    rows = record.rows
    milestones = _curves(rows, "train/", record.task.milestone_names)
    kinds = _curves(rows, "train/", SUCCESS) or _curves(rows, "eval/", SUCCESS)
    terms = _curves(rows, "train/reward/", record.reward_weights)
    charts = [
        line_chart("success_held", _by_purpose(rows, "success_held"), _STEPS, _SHARE),
        line_chart("Return", _by_purpose(rows, "return"), _STEPS, _VALUE),
        line_chart("Milestones reached in training", milestones, _STEPS, _SHARE),
        line_chart("Three measures of success", kinds, _STEPS, _SHARE),
        line_chart("Reward of a step in training, by term", terms, _STEPS, _VALUE),
    ]
    return [chart for chart in charts if chart]


def learner_charts(record: RunRecord) -> list[Markup]:
    """One chart for each number that the learner reports."""
    names = sorted({name for row in record.rows for name in row if _of_learner(name)})
    return [
        line_chart(
            name.removeprefix("learn/").replace("_", " "),
            _curves(record.rows, "learn/", [name.removeprefix("learn/")]),
            _STEPS,
            _VALUE,
        )
        for name in names
    ]


def compared_charts(records: Sequence[RunRecord]) -> list[Markup]:
    """Success and return of all runs over each other."""
    lasting = [
        Line(record.name, *_points(record.rows, *EVALUATED)) for record in records
    ]
    returns = [
        Line(record.name, *_points(record.rows, "train/return")) for record in records
    ]
    charts = [
        line_chart("success_held in evaluations", lasting, _STEPS, _SHARE),
        line_chart("Return of training episodes", returns, _STEPS, _VALUE),
    ]
    return [chart for chart in charts if chart]


def _of_learner(name: str) -> bool:
    return name.startswith("learn/")


def _by_purpose(rows: Sequence[Mapping[str, float]], name: str) -> list[Line]:
    """A measure in evaluations that choose the policy, light ones, and training."""
    lines = [Line(title, *_points(rows, f"{kind}/{name}")) for kind, title in KINDS]
    return [line for line in lines if line.x]


def _curves(
    rows: Sequence[Mapping[str, float]], prefix: str, names: Iterable[str]
) -> list[Line]:
    lines = [Line(name, *_points(rows, f"{prefix}{name}")) for name in names]
    return [line for line in lines if line.x]


def _points(
    rows: Sequence[Mapping[str, float]], *columns: str
) -> tuple[list[float], list[float]]:
    """Control steps and values of the rows that have one of the columns."""
    known = [(row["env_steps"], row[c]) for row in rows for c in columns if c in row]
    return [steps for steps, _ in known], [value for _, value in known]
