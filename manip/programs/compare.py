"""`manip compare`: learning curves, options and success of runs side by side."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Annotated, Any

import tyro
from rich.table import Table
from rich.text import Text

from manip.errors import UserError
from manip.evaluation.statistics import Rate, difference_of_rates
from manip.io.atomic_files import write_text
from manip.io.csv_text import csv_text
from manip.io.output_paths import PLOT_FORMATS, check_output
from manip.io.printable import printable
from manip.programs import cli
from manip.programs.output import console, print_path
from manip.studies.run_groups import (
    MEASURE,
    NONE,
    Group,
    differences,
    groups_of,
    load_runs,
)


@dataclass(frozen=True)
class Compare:
    """Compare training runs, finished or not.

    Runs whose options are equal, apart from the seed, are a group. Prints the options
    in which groups differ, and for each group success_held of its best policies with
    its 95 % interval, and the difference from the first group with that of the
    difference. The rates are those of eval.json where all runs have one (`manip
    evaluate RUN --json RUN/eval.json`, `manip sweep`), otherwise those of the
    evaluations that chose the policies during training, which are a little too high.
    Intervals cover seeds and episodes; of one seed, episodes only.
    """

    runs: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Run folders, or folders of run folders (of `manip train --seeds`, of a sweep)."""
    out: tuple[Path, ...] = ()
    """Files to write, too: the learning curves as a picture (.png, .pdf, .svg: mean and
    range over seeds), the table of groups as .csv."""


def main(arguments: Sequence[str]) -> int:
    """Print the comparison, and write the files."""
    options = cli.parse(Compare, arguments, "manip compare")
    if not options.runs:
        raise UserError("manip compare needs the folder of a run")
    for path in options.out:
        check_output(path, "--out", (*PLOT_FORMATS, ".csv"))
    groups = groups_of(load_runs(options.runs))
    _check_sources(groups)
    _print_options(groups)
    _print_success(groups)
    for path in options.out:
        _write(groups, path)
        print_path(path)
    return 0


def _check_sources(groups: Sequence[Group]) -> None:
    """Refuse rates of evaluations that cannot be compared."""
    runs = [run for group in groups for run in group.runs if run.final]
    sources = {run.source: run.folder for run in runs}
    if len(sources) > 1:
        listed = ", ".join(f"{folder}: {name}" for name, folder in sources.items())
        raise UserError(
            f"runs were evaluated in different ways ({listed}): evaluate all with "
            "`manip evaluate RUN --json RUN/eval.json`"
        )


def _print_options(groups: Sequence[Group]) -> None:
    names = differences([group.options for group in groups])
    if not names:
        return
    table = Table(title="options that differ")
    for column in ("option", *(group.name for group in groups)):
        table.add_column(Text(printable(column)), overflow="fold")
    for name in names:
        values = [group.options.get(name, NONE) for group in groups]
        table.add_row(*(Text(printable(cell)) for cell in (name, *values)))
    console().print(table)


def _print_success(groups: Sequence[Group]) -> None:
    source = groups[0].runs[0].source
    table = Table(title=f"{MEASURE} ({source}), mean over seeds [95 % interval]")
    table.add_column("runs")
    titles = ("seeds", "steps", "minutes", f"{MEASURE} [%]", "difference [points]")
    for title in titles:
        table.add_column(Text(title), justify="right")
    for group in groups:
        row = _row(group, groups[0])
        rates = (_shown(row, "success_held"), _shown(row, "difference"))
        steps, minutes = f"{row['env_steps']:,}", f"{row['minutes']:.1f}"
        cells = (group.name, row["seeds"], steps, minutes, *rates)
        table.add_row(*(Text(printable(str(cell))) for cell in cells))
    console().print(table)


def _row(group: Group, first: Group) -> dict[str, Any]:
    """A group as a row of the .csv file, with its difference from the first."""
    rate = group.rate
    compared = rate and first.rate and group is not first
    difference = difference_of_rates(group.counts, first.counts) if compared else None
    return {
        "runs": group.name,
        "seeds": len(group.runs),
        "env_steps": max(run.steps for run in group.runs),
        "minutes": median(run.seconds for run in group.runs) / 60,
        **_columns(MEASURE, rate),
        **_columns("difference", difference),
    }


def _columns(name: str, rate: Rate | None) -> dict[str, float]:
    if rate is None:
        return {}
    return {name: rate.rate, f"{name}_low": rate.low, f"{name}_high": rate.high}


def _shown(row: Mapping[str, Any], name: str) -> str:
    """A rate in percent with its interval: 97 [92, 99]."""
    if name not in row:
        return NONE
    value, low, high = (100 * row[name + end] for end in ("", "_low", "_high"))
    return f"{value:.0f} [{low:.0f}, {high:.0f}]"


def _write(groups: Sequence[Group], path: Path) -> None:
    if path.suffix == ".csv":
        rows = [_row(group, groups[0]) for group in groups]
        columns = dict.fromkeys(column for row in rows for column in row)
        write_text(path, csv_text(list(columns), rows))
        return
    from manip.studies.compare_figure import draw_comparison  # matplotlib

    draw_comparison(groups, path)
