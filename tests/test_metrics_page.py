"""docs/metrics.md explains every column that a run writes."""

import re
from pathlib import Path

from training_runs import by_algorithm, finished

from manip.envs.external_task import ExternalTask
from manip.envs.task_registry import load_task, task_names
from manip.training.run_logs import read_metrics

PAGE = Path(__file__).parents[1] / "docs" / "metrics.md"


def explained() -> list[str]:
    """Regular expressions of the names in the first cells of the page's tables."""
    cells = re.findall(r"^\|([^|]*)\|", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    names = [name for cell in cells for name in re.findall("`([^`]+)`", cell)]
    return [re.sub("<[a-z]+>", r"[^/]+", re.escape(name)) for name in names]


@by_algorithm
def test_every_column_of_a_run_is_explained(algo: str) -> None:
    patterns, (row, *_) = (
        explained(),
        read_metrics(finished(algo).folder / "metrics.csv"),
    )
    missing = [n for n in row if not any(re.fullmatch(p, n) for p in patterns)]
    assert len(row) > 15
    assert missing == []


def test_milestones_and_reward_terms_of_every_task_are_listed() -> None:
    text, tasks = PAGE.read_text(encoding="utf-8"), map(load_task, task_names())
    rows = [
        f"| {task.name} | {', '.join(task.milestone_names)} | "
        f"{', '.join(task.weights['shaped'])} |\n"
        for task in tasks
        if not isinstance(task, ExternalTask)
    ]
    assert len(rows) > 10
    assert [row for row in rows if row not in text] == []
