"""`manip benchmark gpu`: speed and memory of MuJoCo Warp."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from manip.benchmarks.bench_gpu import GpuSettings, comparison
from manip.benchmarks.rounds import Settings, measure, save, show
from manip.envs.task_registry import load_task
from manip.errors import UserError, at_least
from manip.io.option_ranges import COUNT
from manip.io.output_paths import check_output
from manip.programs import cli
from manip.programs.output import console
from manip.sim.scene import Fidelity
from manip.sim.warp.library import Device


@dataclass(frozen=True)
class BenchmarkGpu:
    """Measure MuJoCo Warp: control steps per second and memory, for several N.

    physics: mujoco_warp without control laws; engine: with control laws and guard;
    task: with rewards, observations and resets on the host; task on the device: with
    rewards and observations there, for tasks that can. Needs the extra gpu.
    """

    task: str = "Lift"
    """Task to simulate (see `manip list`)."""
    fidelity: Fidelity = "exact"
    """Physics: exact as stock robosuite, or fast as in most training."""
    device: Device = "cuda"
    """Device; cpu runs the same kernels on one core: choose few environments."""
    num_envs: Annotated[tuple[int, ...], COUNT] = (256, 1024, 4096, 16384)
    """Numbers of environments."""
    rounds: int = 3
    """Number of rounds, in each of which every candidate is measured once."""
    json: Path | None = None
    """File for figures, medians and spreads, as JSON."""


def main(arguments: Sequence[str]) -> int:
    """Run the benchmark and print its table."""
    options = cli.parse(BenchmarkGpu, arguments, "manip benchmark gpu")
    at_least(1, "--rounds", options.rounds)
    if not options.num_envs:
        raise UserError("--num-envs needs a number")
    for number in options.num_envs:
        at_least(1, "--num-envs", number)
    load_task(options.task)
    if options.json:
        check_output(options.json, "--json")
    settings = GpuSettings(
        options.task, options.fidelity, options.device, options.num_envs
    )
    measurements = measure(comparison(settings), options.rounds)
    if options.json:
        shared = Settings(options.task, max(options.num_envs), options.rounds)
        save(measurements, shared, options.json)
    show(measurements, console())
    return 0
