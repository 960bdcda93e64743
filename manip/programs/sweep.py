"""`manip sweep`: train every combination of options and seeds, and compare them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

from manip.cluster.executors import local_executor, run_jobs, with_threads
from manip.cluster.grid import (
    Cell,
    Grid,
    cells_of,
    grid_of_arguments,
    split_options,
)
from manip.cluster.job import Executor, Job, Outcome
from manip.cluster.ray_executor import RayExecutor
from manip.cluster.sweep_folder import (
    Planned,
    check_sweep,
    plan,
    read_grids,
    write_grids,
)
from manip.cluster.sweep_results import read_results, write_results
from manip.errors import UserError
from manip.programs import cli
from manip.programs.aggregate import report
from manip.programs.output import console
from manip.programs.train import config_of
from manip.training.config import TrainConfig
from manip.training.final_evaluation import EvaluationOptions, check_episodes
from manip.training.lifecycle import locked

FAILED, STOPPED = 1, 3
"""Exit codes: a run failed; the sweep was interrupted and saved."""


@dataclass(frozen=True)
class Sweep:
    """Train every combination of the values of options, and compare the results.

    Every option of `manip train` may be given with several values:

    manip sweep --task Lift Stack --algo sac td3 --seed 0:5 --agent.gamma 0.95 0.97
    --out sweeps/a

    trains 40 runs, each as `manip train` with these options. 0:5 means the seeds 0, 1,
    2, 3, 4. An option that takes a list (--agent.actor-hidden 64 64) is given several
    times for several values; an option that is on or off as --overlap --no-overlap.

    All options are checked before the first run begins. Runs take place in parallel,
    one thread each, as many as there are CPUs. A run that fails does not stop the
    others. Ctrl-C saves all runs; the same command continues them. A sweep can be
    enlarged by more values or seeds.

    OUT holds a run folder for each combination (runs/), the messages of each run
    (logs/), results.csv, and the comparison over seeds: aggregates.csv, improvement.csv
    and aggregates.png. `manip aggregate` compares several sweeps.

    The exit code is 1 if a run failed, 3 if the sweep was interrupted.
    """

    out: Path
    """Folder of the sweep: new, or of the same sweep, which is continued."""
    grid: Path | None = None
    """YAML file with options and their values, as `algo: [sac, td3]`; a list of such
    mappings is a union of grids. Options of the command line replace those in it."""
    episodes: int = 50
    """Episodes in which each trained policy is evaluated in stock robosuite. More
    episodes give more exact rates. 0: the best evaluation of training counts."""
    processes: int | None = None
    """Number of runs at a time on this machine; one for each usable CPU unless
    given."""
    ray: str | None = None
    """Run on the Ray cluster at this address (host:port), or on the one that this
    machine belongs to (auto), instead of on this machine alone. Each run takes
    --threads CPUs, one unless given. Needs the package ray on all machines."""


OWN = {f"--{field.name}" for field in fields(Sweep)}


def main(arguments: Sequence[str]) -> int:
    """Run the sweep, and print and write its results."""
    options, grid = _parse(arguments)
    check_episodes(options.episodes, least=0)
    grids = _grids(options, grid)
    planned = _planned(options, grids)
    check_sweep(options.out, planned)
    executor, jobs = _executor(options, [item.job for item in planned])
    with locked(options.out):
        write_grids(options.out, grids)
        outcomes = run_jobs(
            jobs, executor, lambda done: write_results(options.out, planned, done)
        )
    return _finish(options.out, planned, outcomes)


def _parse(arguments: Sequence[str]) -> tuple[Sweep, Grid]:
    """The sweep's own options, and the grid of the others."""
    if {"-h", "--help"} & set(arguments):
        cli.parse(Sweep, ["--help"], "manip sweep")
    own: list[str] = []
    others: list[str] = []
    for option, words in split_options(arguments):
        (own if option in OWN else others).extend((option, *words))
    return cli.parse(Sweep, own, "manip sweep"), grid_of_arguments(others)


def _grids(options: Sweep, given: Grid) -> list[Grid]:
    """The grids of the file, with the options of the command line in place of theirs.

    The command line alone is a grid, too.
    """
    if options.grid is None:
        return [given]
    return [grid | given for grid in read_grids(options.grid)]


def _planned(options: Sweep, grids: Sequence[Grid]) -> list[Planned]:
    cells = [cell for grid in grids for cell in cells_of(grid)]
    configs: dict[tuple[str, ...], TrainConfig] = {}
    for cell in cells:
        if cell.arguments not in configs:
            configs[cell.arguments] = _config(cell)
    evaluation = EvaluationOptions(episodes=options.episodes, processes=1)
    pairs = [(cell, configs[cell.arguments]) for cell in cells]
    return plan(options.out, pairs, evaluation if options.episodes else None)


def _config(cell: Cell) -> TrainConfig:
    try:
        return config_of(cell.arguments)
    except UserError as error:
        raise UserError(f"manip train {' '.join(cell.arguments)}: {error}") from error


def _executor(options: Sweep, jobs: Sequence[Job]) -> tuple[Executor, list[Job]]:
    logs = options.out / "logs"
    if options.ray is None:
        return local_executor(jobs, options.processes, logs)
    if options.processes is not None:
        raise UserError("--processes has no effect with --ray: leave it out")
    return RayExecutor(options.ray, options.out, logs), with_threads(jobs, 1)


def _finish(
    out: Path, planned: Sequence[Planned], outcomes: Mapping[str, Outcome]
) -> int:
    """Print and write the results; the exit code."""
    failed = [name for name, o in outcomes.items() if o.status == "failed"]
    for name in failed:
        text = f"{name} failed: {outcomes[name].error} (see {out}/logs/{name}.log)"
        console().print(text, style="red", highlight=False, markup=False)
    if any(outcome.status == "finished" for outcome in outcomes.values()):
        report(read_results([out]), "success_held", out)
    finished = sum(outcome.status == "finished" for outcome in outcomes.values())
    if finished + len(failed) < len(planned):
        text = f"{finished} of {len(planned)} runs have finished; the same command "
        console().print(text + "continues the others", highlight=False)
        return STOPPED
    return FAILED if failed else 0
