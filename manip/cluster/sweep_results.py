"""Results of sweeps: one row per run, in the sweep's results.csv."""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from manip.cluster.job import Outcome
from manip.cluster.sweep_folder import Planned
from manip.errors import UserError, one_line
from manip.evaluation.report import SUCCESS
from manip.io.atomic_files import write_text
from manip.io.csv_text import csv_text

RESULTS = "results.csv"

OWN_COLUMNS = (
    *("run", "task", "algo", "seed", "status", "env_steps", "seconds"),
    *("evaluated", "episodes", *SUCCESS, "return_mean", "error"),
)
"""Columns of results.csv; the others are options of the grid."""


@dataclass(frozen=True)
class ScoredRun:
    """A finished run and its success.

    Attributes:
        task, seed: of the run.
        options: the algorithm and all other options of the grid -> value as text.
        success: success_once, success_at_end, success_held -> rate.
    """

    task: str
    seed: int
    options: Mapping[str, str]
    success: Mapping[str, float]


def write_results(
    folder: Path, planned: Sequence[Planned], outcomes: Mapping[str, Outcome]
) -> None:
    """Write results.csv: a row per run, those that have not ended as "waiting".

    Args:
        folder: of the sweep.
        planned: its runs.
        outcomes: name of a run -> how it ended.
    """
    options = dict.fromkeys(n for item in planned for n in item.values)
    columns = [*OWN_COLUMNS, *(n for n in options if n not in OWN_COLUMNS)]
    rows = [_row(item, outcomes.get(item.job.name)) for item in planned]
    write_text(folder / RESULTS, csv_text(columns, rows))


def _row(item: Planned, outcome: Outcome | None) -> dict[str, Any]:
    config = item.job.config
    row: dict[str, Any] = {
        **item.values,
        "run": item.job.name,
        "task": config.task,
        "algo": config.algo,
        "seed": config.seed,
        "status": outcome.status if outcome else "waiting",
        "error": outcome.error if outcome else "",
    }
    return row | (_result_columns(outcome) if outcome else {})


def _result_columns(outcome: Outcome) -> dict[str, Any]:
    result = outcome.result
    if result is None:
        return {}
    return {
        "env_steps": result.env_steps,
        "seconds": round(result.seconds, 1),
        "evaluated": result.evaluation.get("env", "training"),
        "episodes": result.evaluation.get("episodes", ""),
        "return_mean": "" if result.return_mean is None else result.return_mean,
        **(result.success or result.training),
    }


def read_results(folders: Sequence[Path]) -> list[ScoredRun]:
    """The finished runs of several sweep folders.

    Raises:
        UserError: a folder holds no results, or damaged ones; two folders hold the
            same run; runs were evaluated in different ways.
    """
    rows = [row for folder in folders for row in _read(folder / RESULTS)]
    finished = [row for row in rows if row["status"] == "finished"]
    if not finished:
        raise UserError(f"no run has finished in {', '.join(map(str, folders))}")
    ways = sorted({f"{row['evaluated']} {row['episodes']}".strip() for row in finished})
    if len({row["evaluated"] for row in finished}) > 1:
        raise UserError(f"runs were evaluated in different ways: {', '.join(ways)}")
    runs = [_scored(row) for row in finished]
    _check_distinct(runs)
    return runs


def _read(path: Path) -> list[dict[str, str]]:
    if not path.is_file():
        raise UserError(f"there is no {path}: is {path.parent} the folder of a sweep?")
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        _check_rows(rows)
    except (csv.Error, KeyError, TypeError, ValueError) as error:
        raise UserError(f"{path} is damaged: {one_line(error)}") from error
    return rows


def _check_rows(rows: Sequence[Mapping[str, str]]) -> None:
    for row in rows:
        if None in row or None in row.values():
            raise ValueError("a row has another number of columns than the first line")
        if row["status"] == "finished":
            _scored(row)


def _scored(row: Mapping[str, str]) -> ScoredRun:
    options = {n: v for n, v in row.items() if n not in OWN_COLUMNS}
    return ScoredRun(
        task=row["task"],
        seed=int(row["seed"]),
        options={"algo": row["algo"], **options},
        success={measure: float(row[measure]) for measure in SUCCESS},
    )


def _check_distinct(runs: Sequence[ScoredRun]) -> None:
    seen_runs = set()
    for run in runs:
        given = {name: value for name, value in run.options.items() if value}
        key = run.task, run.seed, tuple(sorted(given.items()))
        if key in seen_runs:
            raise UserError(
                f"two folders hold the same run ({run.task}, seed {run.seed}, "
                f"{', '.join(f'{n} {v}' for n, v in given.items())}): leave one out"
            )
        seen_runs.add(key)
