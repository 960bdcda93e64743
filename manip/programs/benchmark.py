"""`manip benchmark`: compare speeds of candidates that are measured in turns."""

import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from manip.benchmarks.rounds import Settings, measure, save, show
from manip.envs.task_registry import load_task
from manip.errors import UserError, at_least
from manip.io.output_paths import PLOT_FORMATS, check_output
from manip.programs import benchmark_gpu, benchmark_task, cli
from manip.programs.output import console


@dataclass(frozen=True)
class Benchmark:
    """Measure speeds and returns; all candidates are measured in turns in one run.

    engine: batch engine, MuJoCo's bare physics and stock robosuite.

    cameras: images per CPU second, exact and lean, beside robosuite's own
    (--plot FILE).

    env: TorchRL and Gymnasium environments and a collect loop with a policy, as a
    fraction of the engine's speed.

    collectors: PPO's rollouts in this process, and in another one on Ray.

    machines: PPO and SAC with up to 64 collectors, which wait instead of simulating,
    against the model of docs/scaling.md.

    startup: seconds to the first control step, with cold and warm compile cache.

    scaling: speed against environments, threads and size of the model (--plot FILE).

    learner: SAC updates and PPO epochs per second, against other libraries (needs
    `make peers`).

    returns: PPO and SAC on Pendulum-v1 beside Stable-Baselines3's, one seed per round
    (needs `make peers`).

    envpool: EnvPool's PandaPickCube beside the engine (needs `make peers`).

    task: wall time until a task is learned; see `manip benchmark task --help`.

    gpu: MuJoCo Warp on an NVIDIA GPU; see `manip benchmark gpu --help`.
    """

    what: Annotated[
        Literal[
            "engine",
            "cameras",
            "env",
            "collectors",
            "machines",
            "startup",
            "scaling",
            "learner",
            "returns",
            "envpool",
        ],
        tyro.conf.Positional,
    ]
    """Benchmark to run."""
    task: str = "Lift"
    """Task to simulate (see `manip list`)."""
    num_envs: int = 64
    """Number of environments that are stepped in parallel."""
    rounds: int = 7
    """Number of rounds, in each of which every candidate is measured once."""
    json: Path | None = None
    """File for figures, medians and spreads, as JSON."""
    plot: Path | None = None
    """File for a figure, .png, .pdf or .svg: of the result (scaling), or of the images
    (cameras)."""


def main(arguments: Sequence[str]) -> int:
    """Run the benchmark and print its table."""
    if list(arguments[:1]) == ["task"]:
        return benchmark_task.main(arguments[1:])
    if list(arguments[:1]) == ["gpu"]:
        return benchmark_gpu.main(arguments[1:])
    options = cli.parse(Benchmark, arguments, "manip benchmark")
    benchmark = importlib.import_module(f"manip.benchmarks.bench_{options.what}")
    _check(options, benchmark)
    settings = Settings(options.task, options.num_envs, options.rounds)
    measurements = measure(benchmark.comparison(settings), settings.rounds)
    if options.json:
        save(measurements, settings, options.json)
    if options.plot:
        benchmark.plot(measurements, options.plot)
    show(measurements, console())
    return 0


def _check(options: Benchmark, benchmark: Any) -> None:
    at_least(1, "--num-envs", options.num_envs)
    at_least(1, "--rounds", options.rounds)
    load_task(options.task)
    if options.plot and not hasattr(benchmark, "plot"):
        raise UserError(
            f"--plot draws `scaling` and `cameras` only, not {options.what!r}"
        )
    if options.json:
        check_output(options.json, "--json")
    if options.plot:
        check_output(options.plot, "--plot", PLOT_FORMATS)
