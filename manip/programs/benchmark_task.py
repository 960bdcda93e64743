"""`manip benchmark task`: wall time and steps until a task is learned."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from manip.benchmarks.bench_task import manip_runs, sb3_runs
from manip.benchmarks.peers import import_peer
from manip.benchmarks.time_to_success import (
    TimedRun,
    figures,
    median_time,
    summary,
    table,
)
from manip.cpus import usable_cpus
from manip.envs.task_registry import load_task
from manip.errors import UserError, at_least
from manip.io.atomic_files import write_text
from manip.io.output_paths import check_output
from manip.programs import cli
from manip.programs.output import console
from manip.versions import versions

Runs = Sequence[TimedRun]


@dataclass(frozen=True)
class TaskBenchmark:
    """Measure the wall time until a task is learned, evaluated in stock robosuite.

    manip: the shipped recipe of SAC, one seed after another on all CPUs. The whole run
    is timed, from the construction of its environments on, with compiled code.

    Stable-Baselines3: SAC on stock robosuite with robosuite's shaped reward and the
    options of robosuite's own benchmark, evaluated twelve times on the way.

    Evaluations in stock robosuite are not timed. The goal is success_held in 95 % of
    the episodes. A run that misses it counts as infinite in the median.
    """

    task: str = "Lift"
    """Task to learn (see `manip list`)."""
    seeds: int = 5
    """Number of manip's runs, with seeds 0, 1, ..."""
    episodes: int = 100
    """Episodes of each evaluation in stock robosuite."""
    peer: bool = True
    """Also run Stable-Baselines3 (needs `make peers`)."""
    peer_seeds: int = 1
    """Number of Stable-Baselines3's runs."""
    cap: float = 60.0
    """Time limit of a run of Stable-Baselines3 [minutes]."""
    json: Path | None = None
    """File for figures and runs, as JSON."""


def main(arguments: Sequence[str]) -> int:
    """Run the benchmark and print its table."""
    options = cli.parse(TaskBenchmark, arguments, "manip benchmark task")
    _check(options)
    manip = list(manip_runs(options.task, options.seeds, options.episodes))
    sb3 = _sb3(options)
    if options.json:
        write_text(options.json, _record(options, manip, sb3))
    _print(options, manip, sb3)
    return 0


def _check(options: TaskBenchmark) -> None:
    for name in ("seeds", "episodes", "peer_seeds"):
        at_least(1, f"--{name.replace('_', '-')}", getattr(options, name))
    if not 0 < options.cap < float("inf"):
        raise UserError(f"--cap must be more than 0 minutes, not {options.cap}")
    if options.json:
        check_output(options.json, "--json")
    load_task(options.task)
    if options.peer:
        import_peer("task_sb3")


def _sb3(options: TaskBenchmark) -> list[TimedRun]:
    if not options.peer:
        return []
    limit = 60 * options.cap
    return list(sb3_runs(options.task, options.peer_seeds, limit, options.episodes))


def _print(options: TaskBenchmark, manip: Runs, sb3: Runs) -> None:
    shown = console()
    shown.print(table(options.task, [*manip, *sb3]))
    shown.print(f"manip, median: {median_time(manip):,.1f} s", highlight=False)
    for run in sb3:
        shown.print(summary(run), highlight=False)


def _record(options: TaskBenchmark, manip: Runs, sb3: Runs) -> str:
    record = {
        "figures": figures(manip, sb3),
        "runs": [run.to_dict() for run in (*manip, *sb3)],
        "task": options.task,
        "episodes": options.episodes,
        "cap_seconds": 60 * options.cap,
        "cpus": usable_cpus(),
        "versions": versions(),
    }
    return json.dumps(record, indent=2) + "\n"
