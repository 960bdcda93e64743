"""`manip aggregate`: compare the runs of one sweep or several."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from manip.cluster.sweep_results import ScoredRun, read_results
from manip.cluster.sweep_summary import Summary
from manip.errors import UserError
from manip.io.output_paths import check_output_folder
from manip.programs import cli
from manip.programs.output import console, print_path


@dataclass(frozen=True)
class Aggregate:
    """Compare the finished runs of sweeps, over seeds and tasks.

    Prints the mean and the interquartile mean (IQM, the mean without the lowest and
    highest quarter of the seeds) of each variant's success, and the probability that a
    seed of it succeeds more often than one of the best variant. 95 % intervals are
    those of a bootstrap over the seeds of each task (the statistics of rliable). Writes
    aggregates.csv, improvement.csv (all pairs) and aggregates.png.
    """

    sweeps: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Folders of sweeps. Runs with other seeds, tasks or options add up."""
    measure: Literal["success_once", "success_at_end", "success_held"] = "success_held"
    """Rate that is compared: success in one control step or more of an episode, in its
    last, or in its last 10."""
    out: Path | None = None
    """Folder for tables and figure; that of the sweep unless there are several."""


def main(arguments: Sequence[str]) -> int:
    """Read the results, print the comparison and write it."""
    options = cli.parse(Aggregate, arguments, "manip aggregate")
    if not options.sweeps:
        raise UserError("manip aggregate needs the folder of a sweep")
    if options.out is None and len(options.sweeps) > 1:
        raise UserError("--out is needed to compare several sweeps: name a folder")
    out = options.out or options.sweeps[0]
    check_output_folder(out, "--out")
    report(read_results(options.sweeps), options.measure, out)
    return 0


def report(runs: Sequence[ScoredRun], measure: str, out: Path) -> None:
    """Print the comparison of runs; write its tables and its figure to a folder."""
    from manip.studies.sweep_figure import draw_summary  # matplotlib takes a second

    summary = Summary(runs, measure)
    paths = [*summary.write(out), out / "aggregates.png"]
    draw_summary(summary, paths[-1])
    console().print(summary.table())
    for path in paths:
        print_path(path)
