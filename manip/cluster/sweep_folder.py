"""The folder of a sweep: its grids, a run folder for each cell, logs and results."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

from manip.cluster.grid import Cell, Grid, cells_of, grid_of_mapping, plain_grid
from manip.cluster.job import Job
from manip.errors import UserError
from manip.io.atomic_files import is_partial, write_text
from manip.io.output_paths import check_output_folder
from manip.io.yaml_files import dump_yaml, read_yaml
from manip.training.config import TrainConfig
from manip.training.final_evaluation import EvaluationOptions
from manip.training.run_folder import check_run_options

GRID = "sweep.yaml"
"""File of a sweep folder with its grids; `manip sweep --grid` reads it."""

LONGEST_NAME = 120
"""Characters of a run folder's name; longer ones end in a checksum."""


@dataclass(frozen=True)
class Planned:
    """A cell of the sweep, and the job that runs it.

    Attributes:
        values: option -> its value as text, for the options of the cell's grid.
        job: the run, in its folder.
    """

    values: Mapping[str, str]
    job: Job


def read_grids(path: Path) -> list[Grid]:
    """Read a YAML file: a mapping of options, or a list of several.

    Raises:
        UserError: there is no such file, it is damaged, or no grid.
    """
    if not path.exists():
        raise UserError(f"there is no file {path}")
    values = read_yaml(path, as_text=True)
    many = values if isinstance(values, list) else [values]
    if not many:
        raise UserError(f"{path} holds no grid")
    try:
        return [grid_of_mapping(mapping) for mapping in many]
    except UserError as error:
        raise UserError(f"{path}: {error}") from error


def plan(
    folder: Path,
    cells: Sequence[tuple[Cell, TrainConfig]],
    evaluation: EvaluationOptions | None,
) -> list[Planned]:
    """Name the runs of a sweep and set their folders.

    Args:
        folder: of the sweep.
        cells: with the options of each run, apart from seed and folder.
        evaluation: at the end of each run.

    Raises:
        UserError: two cells are the same run.
    """
    varied = _varied([cell.values for cell, _ in cells])
    planned = []
    for cell, config in cells:
        name = _name(cell, config, varied)
        run = replace(config, seed=cell.seed, out=folder / "runs" / name)
        planned.append(Planned(cell.values, Job(name, run, evaluation)))
    _check_duplicates([item.job for item in planned])
    return planned


def _varied(values: Sequence[Mapping[str, str]]) -> list[str]:
    """Options whose value differs between cells, or that only some cells have."""
    names = dict.fromkeys(name for v in values for name in v)
    return [n for n in names if len({v.get(n) for v in values}) > 1]


def _name(cell: Cell, config: TrainConfig, varied: Sequence[str]) -> str:
    options = [
        f"{name.split('.')[-1]}={cell.values[name]}"
        for name in varied
        if name in cell.values and name not in ("task", "algo")
    ]
    parts = [config.task, config.algo, *options, str(cell.seed)]
    name = re.sub(r"[^\w.=,+-]", "_", "-".join(parts))
    if len(name) <= LONGEST_NAME:
        return name
    mark = sha256("-".join(parts).encode()).hexdigest()[:12]
    return f"{name[: LONGEST_NAME - len(mark) - 1]}-{mark}"


def _check_duplicates(jobs: Sequence[Job]) -> None:
    names: dict[str, str] = {}
    for job in jobs:
        options = repr(replace(job.config, out=None))
        if options in names or job.name in names.values():
            twin = names.get(options, job.name)
            raise UserError(f"the grid holds a run twice: {twin} and {job.name}")
        names[options] = job.name


def check_sweep(folder: Path, planned: Sequence[Planned]) -> None:
    """Check that a folder is new, or holds the same sweep or a part of it.

    Raises:
        UserError: it holds other files, another sweep, or runs with other options; it
            cannot be written.
    """
    check_output_folder(folder, "--out")
    _check_same_sweep(folder, planned)
    for item in planned:
        check_run_options(item.job.config)


def _check_same_sweep(folder: Path, planned: Sequence[Planned]) -> None:
    path = folder / GRID
    if not path.is_file():
        names = [p.name for p in folder.iterdir()] if folder.is_dir() else []
        others = sorted(n for n in names if n != "run.lock" and not is_partial(Path(n)))
        if others:
            raise UserError(
                f"{folder} is not empty, and holds no sweep (it holds {others[0]}): "
                "choose another folder with --out"
            )
        return
    cells = {_key(item) for item in planned}
    stored = {
        (tuple(sorted(cell.values.items())), cell.seed)
        for grid in read_grids(path)
        for cell in cells_of(grid)
    }
    if not stored <= cells:
        raise UserError(
            f"{folder} holds another sweep ({path} lists its options): choose another "
            "folder with --out, or repeat its options, with more seeds or values"
        )


def _key(item: Planned) -> tuple[Any, int]:
    return tuple(sorted(item.values.items())), item.job.config.seed


def write_grids(folder: Path, grids: Sequence[Grid]) -> None:
    """Record the grids of a sweep in its folder."""
    plain = [plain_grid(grid) for grid in grids]
    write_text(folder / GRID, dump_yaml(plain[0] if len(plain) == 1 else plain))
