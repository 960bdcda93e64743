"""`manip benchmark task`: wall time and steps until a task is learned."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from manip.benchmarks.attempts import Attempt, figures, median_time, table, verdict
from manip.benchmarks.bench_task import ours, peers
from manip.benchmarks.peers import peer
from manip.cpus import usable_cpus
from manip.envs.task_registry import load_task
from manip.errors import UserError, at_least
from manip.io.atomic_files import write_text
from manip.programs import cli
from manip.versions import versions


@dataclass(frozen=True)
class TaskBenchmark:
    """Measure how long a task takes to learn, judged in stock robosuite.

    Ours is `manip train` with the shipped recipe of SAC, in a fresh process a seed:
    the whole process counts, compiled code being in the cache. The peer is
    Stable-Baselines3's SAC on stock robosuite with robosuite's shaped reward and the
    options of robosuite's own benchmark, looked at twelve times on the way. Evaluation
    in stock robosuite counts as nobody's time. A run that holds success in less than
    95 % of its episodes has missed: its time is infinite in the median.
    """

    task: str = "Lift"
    """Task to learn."""
    seeds: int = 5
    """Runs of ours, with seeds 0, 1, ..."""
    episodes: int = 100
    """Episodes of each evaluation in stock robosuite."""
    peer: bool = True
    """Run Stable-Baselines3, too (see `make peers`)."""
    peer_seeds: int = 1
    """Runs of Stable-Baselines3."""
    cap: float = 60.0
    """Minutes that a run of Stable-Baselines3 is given."""
    json: Path | None = None
    """Write figures and attempts to this file, too."""


def main(arguments: Sequence[str]) -> int:
    """Run the benchmark and print its table."""
    options = cli.parse(TaskBenchmark, arguments, "manip benchmark task")
    _check(options)
    mine = list(ours(options.task, options.seeds, options.episodes))
    theirs: list[Attempt] = []
    if options.peer:
        cap = 60 * options.cap
        theirs += peers(options.task, options.peer_seeds, cap, options.episodes)
    _print(options, mine, theirs)
    if options.json:
        write_text(options.json, _record(options, mine, theirs))
    return 0


def _check(options: TaskBenchmark) -> None:
    for name in ("seeds", "episodes", "peer_seeds"):
        at_least(1, f"--{name.replace('_', '-')}", getattr(options, name))
    if not options.cap > 0:
        raise UserError(f"--cap must be more than 0 minutes, not {options.cap}")
    load_task(options.task)
    if options.peer:
        peer("task_sb3")


def _print(
    options: TaskBenchmark, mine: Sequence[Attempt], theirs: Sequence[Attempt]
) -> None:
    console = Console()
    console.print(table(options.task, [*mine, *theirs]))
    console.print(f"manip, median: {median_time(mine):,.1f} s", highlight=False)
    for attempt in theirs:
        console.print(verdict(attempt), highlight=False)


def _record(
    options: TaskBenchmark, mine: Sequence[Attempt], theirs: Sequence[Attempt]
) -> str:
    record = {
        "figures": figures(mine, theirs),
        "attempts": [attempt.plain() for attempt in (*mine, *theirs)],
        "task": options.task,
        "episodes": options.episodes,
        "cap_seconds": 60 * options.cap,
        "cpus": usable_cpus(),
        "versions": versions(),
    }
    return json.dumps(record, indent=2) + "\n"
