"""`manip evaluate`: measure a policy's success over many episodes."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import torch
import tyro
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from manip.cameras import Quality
from manip.envs.external_task import simulator_of
from manip.envs.make_batch import Backend
from manip.errors import UserError, at_least
from manip.evaluation.episode_table import episode_rows, episodes_csv
from manip.evaluation.report import Evaluation, table
from manip.evaluation.robustness import robustness_table
from manip.evaluation.robustness_figure import draw_robustness
from manip.evaluation.runners import Progress as Count
from manip.evaluation.stress_suite import load_suite
from manip.io.atomic_files import write_text
from manip.io.output_paths import check_output
from manip.programs import cli
from manip.programs.output import console, print_path
from manip.sim.scene import Fidelity
from manip.sim.warp.library import Device, check_library
from manip.training.baselines import Baseline
from manip.training.final_evaluation import (
    EvaluationOptions,
    check_episodes,
    load_policy_and_task,
    measure_on_task,
)
from manip.training.stress_evaluation import evaluate_under_stress

STRESS_FILES = ("robustness.json", "robustness.csv", "robustness.png")

EPISODES = "episodes.csv"


@dataclass(frozen=True)
class Evaluate:
    """Measure a policy's success on its task.

    The policy acts without exploration noise, in episodes that no policy is trained
    or chosen on. The table gives success_once (in at least one control step),
    success_at_end (in the last) and success_held (in the last 10), each with its
    Wilson 95 % interval. The interval covers the choice of episodes; it does not cover
    how training with another seed would turn out.
    """

    run: Annotated[Path, tyro.conf.Positional]
    """Run folder, policy folder, checkpoint file, or name of a shipped policy (see
    `manip list`). With --policy, the task instead."""
    policy: Baseline | None = None
    """Policy that needs no training. expert: the task's expert; random: random actions;
    untrained: a network as a training begins with it."""
    robot: str = "Panda"
    """Robot arm with --policy; a trained policy has its own."""
    env: Annotated[Backend, tyro.conf.arg(aliases=("--engine",))] = "stock"
    """Backend that simulates the episodes. stock: robosuite.make(...) itself, or the
    library that defines the task; native: the batch engine, many times faster; warp:
    MuJoCo Warp (the extra gpu), in float32: quote results of the other two."""
    episodes: int = 100
    """Number of episodes. More episodes narrow the intervals and take longer."""
    seed: int = 0
    """Seed of the episodes' random streams. Two seeds have no episode in common."""
    fidelity: Fidelity = "exact"
    """Physics of the native engine: exact as stock robosuite, or fast."""
    taste: str | None = None
    """Taste whose mean penalty per control step is measured, too: one of the task's
    (see `manip list`), or a YAML file of your own."""
    looks: str | None = None
    """Fixed looks of the images, in turn, to test robustness (native engine): one of
    unseen-textures, unseen-lights, unseen-cameras and unseen (all of them), each with
    three looks; with -1, -2 or -3 appended, that look alone."""
    perturb: str | None = None
    """Suite of perturbations, each at several strengths, in the same episodes:
    standard, or a YAML file of your own. --episodes is the number for each strength."""
    image_quality: Quality = "exact"
    """Images of the native engine. exact: robosuite's bytes; lean: several times
    faster, without reflections and with fewer triangles."""
    device: Device | None = None
    """Device of MuJoCo Warp, cuda unless given."""
    njmax: int | None = None
    """Constraint rows that MuJoCo Warp allocates for an environment; as measured for
    the task unless given."""
    nconmax: int | None = None
    """Contacts that MuJoCo Warp allocates for an environment, on average; as measured
    for the task unless given."""
    json: Path | None = None
    """File for the result as JSON, besides the table."""
    out: Path | None = None
    """Folder for the result as JSON (eval.json) and a table of the episodes
    (episodes.csv): success, first step of each milestone, sum of each reward term, and
    with --env native how the robot moved. With --perturb: robustness.json, .csv and
    .png."""


def main(arguments: Sequence[str]) -> int:
    """Evaluate, write the files, print the table and the paths of the files."""
    options = cli.parse(Evaluate, arguments, "manip evaluate")
    _check(options)
    torch.set_num_threads(1)
    if options.perturb:
        console().print(_stress(options))
    else:
        result = evaluate(options)
        if options.json:
            write_text(options.json, result.to_json())
        console().print(table(result))
    for path in _files(options):
        print_path(path)
    return 0


def _files(options: Evaluate) -> list[Path]:
    """The files that the options ask for."""
    names = STRESS_FILES if options.perturb else ("eval.json", EPISODES)
    listed = [options.out / name for name in names] if options.out else []
    return [options.json, *listed] if options.json else listed


def evaluate(options: Evaluate) -> Evaluation:
    """Run the episodes and summarise them, with a progress bar on stderr.

    Raises:
        UserError: an option is out of range, or there is no such policy.
    """
    policy, task = load_policy_and_task(options.run, options.policy, options.robot)
    with _progress(options, policy.card.task, options.episodes) as advance:
        result, episodes = measure_on_task(policy, task, _episodes(options), advance)
    if options.out:
        write_text(options.out / "eval.json", result.to_json())
        write_text(options.out / EPISODES, episodes_csv(episode_rows(episodes, task)))
    return result


def _stress(options: Evaluate) -> Table:
    """Evaluate under perturbations, write the files; return the table."""
    suite = load_suite(str(options.perturb))
    policy, task = load_policy_and_task(options.run, options.policy, options.robot)
    levels = 1 + sum(len(stress.levels) for stress in suite.values())
    total = levels * options.episodes
    with _progress(options, policy.card.task, total) as advance:
        result = evaluate_under_stress(policy, task, _episodes(options), suite, advance)
    if options.json:
        write_text(options.json, result.to_json())
    if options.out:
        as_json, as_csv, figure = (options.out / name for name in STRESS_FILES)
        write_text(as_json, result.to_json())
        write_text(as_csv, result.to_csv())
        draw_robustness(result, figure)
    return robustness_table(result)


def _check(options: Evaluate) -> None:
    if options.json:
        check_output(options.json, "--json")
    if options.out:
        check_output(options.out / EPISODES, "--out")
    check_episodes(options.episodes)
    at_least(0, "--seed", options.seed)
    if options.perturb and options.looks:
        raise UserError("--perturb changes looks itself: drop --looks")
    warp_only = options.device, options.njmax, options.nconmax
    if options.env != "warp" and any(value is not None for value in warp_only):
        raise UserError("--device, --njmax and --nconmax are options of --env warp")
    if options.env == "warp":
        check_library(options.device or "cuda")


def _episodes(options: Evaluate) -> EvaluationOptions:
    return EvaluationOptions(
        options.env,
        options.episodes,
        options.seed,
        options.fidelity,
        taste=options.taste,
        looks=options.looks,
        image_quality=options.image_quality,
        details=options.out is not None and not options.perturb,
        device=options.device,
        njmax=options.njmax,
        nconmax=options.nconmax,
    )


@contextmanager
def _progress(options: Evaluate, task: str, total: int) -> Iterator[Count]:
    """A progress bar on stderr; yields the function that advances it."""
    with Progress(console=Console(stderr=True), transient=True) as bar:
        running = bar.add_task(simulator_of(options.env, task), total=total)
        yield lambda count: bar.advance(running, count)
