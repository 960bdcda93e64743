"""Where a run's numbers go: CSV, TensorBoard and, on request, Weights & Biases."""

import csv
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path

from torchrl.record.loggers import Logger, TensorboardLogger

from manip.errors import UserError
from manip.io.atomic_files import replace_file

Row = Mapping[str, float]
"""Name -> value of what is logged at once; `env_steps` says when."""


class MetricsTable:
    """A CSV file that grows by a row a record; new columns may appear on the way."""

    def __init__(self, path: Path, rows: Sequence[Row]) -> None:
        """Begin the table with the rows that there are already."""
        self._path = path
        self.rows = list(rows)
        self._columns = list(dict.fromkeys(name for row in rows for name in row))
        self._rewrite()

    def add(self, row: Row) -> None:
        """Append a row."""
        self.rows.append(dict(row))
        fresh = [name for name in row if name not in self._columns]
        self._columns += fresh
        if fresh:
            self._rewrite()
            return
        with self._path.open("a", newline="") as file:
            csv.DictWriter(file, self._columns).writerow(row)

    def _rewrite(self) -> None:
        replace_file(self._path, self._write)

    def _write(self, path: Path) -> None:
        with path.open("w", newline="") as file:
            writer = csv.DictWriter(file, self._columns)
            writer.writeheader()
            writer.writerows(self.rows)


def read_metrics(path: Path) -> list[dict[str, str]]:
    """Rows of a run's metrics.csv; none if there is no such file.

    A last line that is not whole yet is left out.
    """
    if not path.is_file():
        return []
    with path.open(newline="") as file:
        whole = [line for line in file if line.endswith("\n")]
    return list(csv.DictReader(whole))


def check_wandb(project: str | None) -> None:
    """Raise `UserError` if Weights & Biases is asked for and not there."""
    if project is not None and find_spec("wandb") is None:
        raise UserError(
            "--wandb needs a package that is not there: pip install wandb, or leave "
            "the option out"
        )


class RunLog:
    """All of a run's logs behind one call.

    Args:
        folder: of the run.
        rows: what was logged up to the checkpoint that the run goes on from; the logs
            are written anew from them, so that no row is there twice or missing.
        wandb_project: logs to Weights & Biases, too.
    """

    def __init__(
        self, folder: Path, rows: Sequence[Row], wandb_project: str | None
    ) -> None:
        self._table = MetricsTable(folder / "metrics.csv", rows)
        for events in (folder / "tensorboard").glob("events.out.tfevents.*"):
            events.unlink()
        self._board = TensorboardLogger("tensorboard", log_dir=str(folder))
        self._loggers: list[Logger] = [self._board]
        for row in rows:
            _log(self._board, row)
        if wandb_project:
            from torchrl.record.loggers import WandbLogger  # an optional extra

            self._loggers.append(
                WandbLogger(folder.name, project=wandb_project, save_dir=str(folder))
            )

    def __enter__(self) -> "RunLog":
        return self

    def __exit__(self, *_: object) -> None:
        self._board.experiment.close()

    @property
    def rows(self) -> list[Row]:
        """All that was logged so far."""
        return self._table.rows

    def write(self, env_steps: int, values: Row) -> None:
        """Log scalars at a number of control steps."""
        row = {"env_steps": env_steps, **values}
        self._table.add(row)
        for logger in self._loggers:
            _log(logger, row)


def _log(logger: Logger, row: Row) -> None:
    for name, value in row.items():
        if name != "env_steps":
            logger.log_scalar(name, value, step=int(row["env_steps"]))
