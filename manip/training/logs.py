"""Where a run's numbers go: CSV, TensorBoard and, on request, Weights & Biases."""

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torchrl.record.loggers import Logger, TensorboardLogger


class MetricsTable:
    """A CSV file that grows by a row a record; new columns may appear on the way."""

    def __init__(self, path: Path, upto: int) -> None:
        """Open the table, dropping rows beyond step `upto` (of a run that resumes)."""
        self._path = path
        rows = [row for row in read_metrics(path) if int(row["env_steps"]) <= upto]
        self._rows: list[dict[str, Any]] = list(rows)
        self._columns = list(self._rows[-1]) if self._rows else []
        self._rewrite()

    def add(self, row: Mapping[str, Any]) -> None:
        """Append a row."""
        self._rows.append(dict(row))
        fresh = [name for name in row if name not in self._columns]
        self._columns += fresh
        if fresh:
            self._rewrite()
            return
        with self._path.open("a", newline="") as file:
            csv.DictWriter(file, self._columns).writerow(row)

    def _rewrite(self) -> None:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with self._path.open("w", newline="") as file:
            writer = csv.DictWriter(file, self._columns)
            writer.writeheader()
            writer.writerows(self._rows)


def read_metrics(path: Path) -> list[dict[str, str]]:
    """Rows of a run's metrics.csv; none if there is no such file."""
    if not path.is_file():
        return []
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


class RunLog:
    """All of a run's logs behind one call."""

    def __init__(self, folder: Path, upto: int, wandb_project: str | None) -> None:
        self._table = MetricsTable(folder / "metrics.csv", upto)
        self._loggers: list[Logger] = [
            TensorboardLogger("tensorboard", log_dir=str(folder))
        ]
        if wandb_project:
            from torchrl.record.loggers import WandbLogger  # an optional extra

            self._loggers.append(
                WandbLogger(folder.name, project=wandb_project, save_dir=str(folder))
            )

    def write(self, env_steps: int, values: Mapping[str, float]) -> None:
        """Log scalars at a number of control steps."""
        self._table.add({"env_steps": env_steps, **values})
        for logger in self._loggers:
            for name, value in values.items():
                logger.log_scalar(name, value, step=env_steps)
