"""`manip benchmark`: how fast, in ratios of contestants that take turns in one run."""

import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from manip.benchmarks.contest import Settings, hold, save, show
from manip.envs.task_registry import load_task
from manip.errors import UserError, at_least
from manip.programs import benchmark_task, cli


@dataclass(frozen=True)
class Benchmark:
    """Measure speed, and returns, everything interleaved in one run.

    engine: the batch engine against MuJoCo's bare physics and stock robosuite.

    env: TorchRL and Gymnasium environments and collect loop with a policy, as a share
    of the engine.

    startup: seconds to the first control step, with cold and warm compile cache.

    scaling: speed against worlds, threads and size of the model (--plot FILE).

    learner: SAC updates and PPO epochs against other libraries (see `make peers`).

    returns: PPO and SAC on Pendulum-v1 beside Stable-Baselines3's, a seed a round (see
    `make peers`).

    envpool: EnvPool's PandaPickCube beside us (see `make peers`).

    task: wall time until a task is learned; see `manip benchmark task --help`.
    """

    what: Annotated[
        Literal["engine", "env", "startup", "scaling", "learner", "returns", "envpool"],
        tyro.conf.Positional,
    ]
    """Which benchmark."""
    task: str = "Lift"
    """Task that is simulated."""
    worlds: int = 64
    """TaskBatch side by side."""
    rounds: int = 7
    """Rounds that all contestants run."""
    json: Path | None = None
    """Write figures, medians and spreads to this file, too."""
    plot: Path | None = None
    """Draw the result as a .png file (scaling)."""


def main(arguments: Sequence[str]) -> int:
    """Run the benchmark and print its table."""
    if list(arguments[:1]) == ["task"]:
        return benchmark_task.main(arguments[1:])
    options = cli.parse(Benchmark, arguments, "manip benchmark")
    for name in ("worlds", "rounds"):
        at_least(1, f"--{name}", getattr(options, name))
    load_task(options.task)
    benchmark = importlib.import_module(f"manip.benchmarks.bench_{options.what}")
    if options.plot and not hasattr(benchmark, "plot"):
        raise UserError(f"--plot draws `scaling` only, not {options.what!r}")
    settings = Settings(options.task, options.worlds, options.rounds)
    outcome = hold(benchmark.contest(settings), settings.rounds)
    show(outcome)
    if options.json:
        save(outcome, settings, options.json)
    if options.plot:
        benchmark.plot(outcome, options.plot)
    return 0
