"""Train the same options with several seeds, each run in a folder of its own."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from manip.cluster.executors import local_executor, run_jobs
from manip.cluster.job import Job, Outcome
from manip.errors import UserError
from manip.io.output_paths import check_output_folder
from manip.training.config import TrainConfig
from manip.training.run_folder import check_run_options


def seeds_folder(config: TrainConfig) -> Path:
    """Folder of the runs of all seeds: runs/<task>-<algo> unless --out is given."""
    default = replace(config, out=None).folder
    return config.out or default.with_name(default.name.removesuffix(f"-{config.seed}"))


def train_seeds(config: TrainConfig, seeds: Sequence[int]) -> dict[str, Outcome]:
    """Train in processes of this machine, or resume, and show the states on stderr.

    Args:
        config: options of the runs; its seed is not used.
        seeds: of the runs.

    Returns:
        seed0, ... -> how the run in the folder of this name ended; those that have not
        begun when the runs are interrupted are left out.

    Raises:
        UserError: a seed is given twice, a folder holds a run with other options, or
            the runs would share a folder of comparisons.
    """
    if len(set(seeds)) < len(seeds):
        raise UserError(f"--seeds holds a seed twice: {' '.join(map(str, seeds))}")
    if config.resume:
        raise UserError("--seeds continues runs by itself: leave out --resume")
    if config.preferences is not None:
        raise UserError(
            "--seeds has no use with --preferences: runs that add comparisons to one "
            "folder would learn from each other's; train them one by one"
        )
    out = seeds_folder(config)
    check_output_folder(out, "--out")
    jobs = [_job(config, out, seed) for seed in seeds]
    for job in jobs:
        check_run_options(job.config)
    executor, jobs = local_executor(jobs, None, out / "logs")
    return run_jobs(jobs, executor)


def _job(config: TrainConfig, out: Path, seed: int) -> Job:
    name = f"seed{seed}"
    return Job(name, replace(config, seed=seed, out=out / name))
