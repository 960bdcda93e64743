"""Where a run's numbers go: CSV, TensorBoard and, on request, Weights & Biases."""

import csv
import netrc
import os
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from manip.errors import UserError, one_line
from manip.io.atomic_files import replace_file
from manip.training.tensorboard_log import TensorboardLog

if TYPE_CHECKING:
    from torchrl.record.loggers import WandbLogger

Row = Mapping[str, float]
"""Name -> value of the scalars logged at one time, `env_steps` among them."""


RENAMED = {"train/success": "train/success_at_end"}
"""Column of earlier versions -> its name today."""


class MetricsTable:
    """A CSV file to which rows are appended; later rows may have new columns."""

    def __init__(self, path: Path, rows: Sequence[Row]) -> None:
        """Write the table anew with the rows that there are already."""
        self._path = path
        self._rows = list(rows)
        self._columns = list(dict.fromkeys(name for row in rows for name in row))
        self._rewrite()

    def add(self, row: Row) -> None:
        """Append a row."""
        self._rows.append(dict(row))
        new = [name for name in row if name not in self._columns]
        self._columns += new
        if new:
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
            writer.writerows(self._rows)


def read_metrics(path: Path) -> list[dict[str, str]]:
    """Rows of a run's metrics.csv; none if there is no such file.

    A last line without line break, which a killed run may leave, is left out.

    Raises:
        UserError: it is no table, or a row does not say its `env_steps`.
    """
    if not path.is_file():
        return []
    try:
        with path.open(newline="", encoding="utf-8") as file:
            complete = [line for line in file if line.endswith("\n")]
        rows = list(csv.DictReader(complete))
        for row in rows:
            int(row["env_steps"])
    except (csv.Error, KeyError, TypeError, ValueError) as error:
        raise UserError(f"{path} is damaged: {one_line(error)}") from error
    return rows


def read_numbers(path: Path) -> list[dict[str, float]]:
    """Rows of a run's metrics.csv as numbers, under today's names of the columns.

    A column that a row has no value for is left out of it.

    Raises:
        UserError: it is no table of numbers, or a row does not say its `env_steps`.
    """
    try:
        return [
            renamed({name: float(value) for name, value in row.items() if value})
            for row in read_metrics(path)
        ]
    except (TypeError, ValueError) as error:
        raise UserError(f"{path} is damaged: {one_line(error)}") from error


def renamed(row: Row) -> dict[str, float]:
    """A row of an earlier version under today's names of the columns.

    A name that has today's beside it is a milestone's.
    """
    old = {name for name, new in RENAMED.items() if name in row and new not in row}
    return {RENAMED[n] if n in old else n: value for n, value in row.items()}


def check_wandb(project: str | None) -> None:
    """Check that a run can log to Weights & Biases, if it is to, before it begins.

    Raises:
        UserError: the library is not installed, or there is no login.
    """
    if project is None:
        return
    if find_spec("wandb") is None:
        raise UserError(
            "--wandb needs the package wandb: pip install wandb, or leave the option "
            "out"
        )
    if not _wandb_needs_no_login() and not _wandb_login():
        raise UserError(
            "--wandb needs a login: run `wandb login`, set WANDB_API_KEY, or set "
            "WANDB_MODE=offline"
        )


def _wandb_needs_no_login() -> bool:
    return os.environ.get("WANDB_MODE") in ("offline", "dryrun", "disabled")


def _wandb_login() -> bool:
    """Whether there is a key, in the environment or where `wandb login` writes it."""
    if os.environ.get("WANDB_API_KEY"):
        return True
    url = os.environ.get("WANDB_BASE_URL", "https://api.wandb.ai")
    try:
        return (
            netrc.netrc(os.environ.get("NETRC")).authenticators(
                urlsplit(url).hostname or ""
            )
            is not None
        )
    except (OSError, netrc.NetrcParseError):
        return False


class RunLog:
    """All logs of a run behind one call.

    Args:
        folder: the run folder.
        rows: rows up to the checkpoint that the run continues from; the logs are
            written anew from them, so that each row is there once.
        options: of the run, as plain values.
        wandb_project: Weights & Biases project to log to, too.

    Raises:
        UserError: Weights & Biases reports an error.
    """

    def __init__(
        self,
        folder: Path,
        rows: Sequence[Row],
        options: Mapping[str, Any],
        wandb_project: str | None,
    ) -> None:
        self._table = MetricsTable(folder / "metrics.csv", rows)
        self._board = TensorboardLog(folder, options)
        for row in rows:
            self._board.write(row)
        self._wandb: WandbLogger | None = None
        if wandb_project:
            self._wandb = _wandb_logger(folder, wandb_project, options)

    def close(self) -> None:
        """Write what is not written yet, and close the files."""
        self._board.close()

    def write(self, row: Row) -> None:
        """Log a row of scalars."""
        self._table.add(row)
        self._board.write(row)
        if self._wandb:
            self._wandb.log_metrics(dict(row), step=int(row["env_steps"]))


def _wandb_logger(
    folder: Path, project: str, options: Mapping[str, Any]
) -> "WandbLogger":
    from torchrl.record.loggers import WandbLogger  # an optional extra

    try:
        logger = WandbLogger(folder.name, project=project, save_dir=str(folder))
        logger.log_hparams(dict(options))
    except Exception as error:  # wandb has many, none of them documented
        raise UserError(f"--wandb {project}: {one_line(error)}") from error
    return logger
