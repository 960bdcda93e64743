"""`manip reproduce`: rerun shipped recipes and compare with the shipped results."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import torch
import tyro

from manip.agents.policy import load_policy
from manip.cluster.executors import finish_runs
from manip.cluster.job import JobResult
from manip.cpus import machine
from manip.envs.episode_streams import CHOICE
from manip.errors import UserError, at_least, check_choice, unknown
from manip.evaluation.comparison import (
    comparison_line,
    comparison_record,
    verdict,
)
from manip.evaluation.runners import EpisodeSettings, evaluate_policy
from manip.evaluation.shipped_results import (
    RESULTS,
    Key,
    Result,
    Results,
    Run,
    load_results,
)
from manip.evaluation.statistics import success_rate
from manip.io.atomic_files import write_text
from manip.io.output_paths import check_output, check_output_folder
from manip.programs import cli
from manip.programs.output import console
from manip.programs.results import table
from manip.programs.ship_policy import ship_policy
from manip.robot_config import ROBOTS
from manip.training.config import TrainConfig
from manip.training.final_evaluation import EvaluationOptions, check_episodes
from manip.training.recipes import recipes
from manip.training.teacher import imitates
from manip.versions import versions

STOPPED = 3
"""Exit code: interrupted and saved."""

CHOICE_EPISODES = 128
"""Native episodes by which the seed of the shipped policy is chosen."""

CAMERA_EPISODES = 32
"""The same for a policy that sees cameras, whose images take most of the time."""

MOST_SEEDS = 1000


@dataclass(frozen=True)
class Reproduce:
    """Rerun shipped recipes, evaluate in stock robosuite, compare with the results.

    Each recipe is trained with seeds 0, 1, ... and every policy is evaluated in
    episodes that it was neither trained nor chosen on. The success rates of all seeds
    are compared with those of the shipped result, with the spread between seeds (a
    one-sided t-test): agrees, worse, better, or cannot tell (fewer than three seeds in
    both together). An unchanged recipe is called worse in less than 5 % of
    reproductions with 3 to 5 seeds. The exit code is 1 if a recipe is worse.

    After an interruption the same command continues.
    """

    what: Annotated[tuple[str, ...], tyro.conf.Positional]
    """Recipes to rerun: names (lift-sac), tasks (Lift: all of its recipes), or all."""
    robot: str | None = None
    """Arm to train. Unless given: the recipe's own, and those that have a result."""
    seeds: int = 3
    """Number of training seeds of each recipe. More seeds find smaller changes."""
    episodes: int = 100
    """Number of evaluation episodes of each seed, in stock robosuite."""
    processes: int | None = None
    """Number of runs at a time; one for each usable CPU unless given."""
    out: Path = Path("runs/reproduce")
    """Folder of the runs."""
    json: Path | None = None
    """File for results and comparisons as JSON; it grows with each recipe."""
    write: bool = False
    """Replace the shipped results (assets/results.yaml), and ship the policy of the
    best seed (assets/policies) if it succeeds in 90 % of its episodes or more.
    It replaces the policy of another algorithm only if the 95 % interval of its rate
    begins above the other's rate. The best seed is chosen in 128 native episodes (32 if
    it sees cameras), which are not those of the results."""


def main(arguments: Sequence[str]) -> int:
    """Train, evaluate, compare: 0 without a worse recipe, 1 with one, 3 stopped."""
    options = cli.parse(Reproduce, arguments, "manip reproduce")
    stored = load_results()
    configs = chosen(options, stored)
    _check(options)
    torch.set_num_threads(1)
    results: list[Result] = []
    for config in configs:
        runs = _runs(config, options)
        if runs is None:
            return STOPPED
        result = Result(*_key(config), imitates(config), machine(), runs)
        results.append(result)
        _save(results, options, stored)
        console().print(comparison_line(result, stored), highlight=False, markup=False)
    console().print(table(stored, results))
    worse = [result for result in results if verdict(result, stored) == "worse"]
    if worse:
        names = ", ".join(" ".join(result.key) for result in worse)
        console().print(f"worse than its result: {names}", style="red")
    return int(bool(worse))


def _check(options: Reproduce) -> None:
    cli.check_range("--seeds", options.seeds, 1, MOST_SEEDS)
    check_episodes(options.episodes)
    if options.processes is not None:
        at_least(1, "--processes", options.processes)
    check_output_folder(options.out, "--out")
    if options.json:
        check_output(options.json, "--json")
    if options.write:
        check_output(RESULTS, "--write")


def chosen(options: Reproduce, stored: Results) -> list[TrainConfig]:
    """The requested recipes, with each of their arms.

    Raises:
        UserError: no such recipe or arm.
    """
    known = recipes()
    if options.robot:
        check_choice("robot", options.robot, ROBOTS)
    names = {*known, *(config.task for config in known.values()), "all"}
    if not options.what:
        raise UserError(
            f"no recipe is named; known recipes: {', '.join(sorted(names))}"
        )
    for name in options.what:
        if name not in names:
            raise unknown("recipe", name, sorted(names))
    pairs = [
        (name, robot)
        for name, config in known.items()
        if {"all", name, config.task} & set(options.what)
        for robot in _robots(config, options, stored)
    ]
    of_robot = {robot: recipes(robot) for robot in {robot for _, robot in pairs}}
    return [of_robot[robot][name] for name, robot in pairs]


def _robots(config: TrainConfig, options: Reproduce, stored: Results) -> list[str]:
    if options.robot:
        return [options.robot]
    others = {
        result.robot
        for result in stored.results
        if (result.task, result.algo) == (config.task, config.method)
    }
    return [config.robot, *sorted(others - {config.robot})]


def _runs(config: TrainConfig, options: Reproduce) -> tuple[Run, ...] | None:
    """Train and evaluate all seeds; None if they were interrupted."""
    runs = [
        replace(config, seed=seed, out=options.out / run_name(_key(config), seed))
        for seed in range(options.seeds)
    ]
    evaluation = EvaluationOptions(episodes=options.episodes, processes=1)
    results = finish_runs(runs, options.processes, evaluation)
    if results is None:
        return None
    return tuple(map(_evaluated, runs, results))


def _evaluated(run: TrainConfig, result: JobResult) -> Run:
    episodes = int(result.evaluation["episodes"])
    return Run(
        seed=run.seed,
        success_held=round(result.success["success_held"] * episodes),
        episodes=episodes,
        env_steps=result.env_steps,
        minutes=round(result.seconds / 60, 1),
        choice_rate=choice_rate(run.folder),
    )


def choice_rate(folder: Path) -> float:
    """Rate of success_held in the episodes by which a seed is chosen.

    They are native and exact, with images as in training, and differ from those of
    training and evaluation.
    """
    policy = load_policy(folder)
    cameras = policy.card.cameras
    if cameras and policy.card.image_quality:
        cameras = replace(cameras, quality=policy.card.image_quality)
    settings = EpisodeSettings(
        task=policy.card.task,
        robot=policy.card.robot_config,
        observation=policy.card.observation,
        cameras=cameras,
        episodes=CAMERA_EPISODES if cameras else CHOICE_EPISODES,
        purpose=CHOICE,
        backend="native",
    )
    episodes = evaluate_policy(policy, settings)
    return success_rate([episode.success_held for episode in episodes]).rate


def run_name(key: Key, seed: int) -> str:
    """Name of the folder of a run."""
    return "-".join((*key, str(seed)))


def _key(config: TrainConfig) -> Key:
    return config.task, config.robot, config.method


def _save(results: Sequence[Result], options: Reproduce, stored: Results) -> None:
    """Write what was requested, with the recipes that are done so far."""
    if options.json:
        record = {
            "results": [comparison_record(result, stored) for result in results],
            "versions": versions(),
        }
        write_text(options.json, json.dumps(record, indent=2) + "\n")
    if options.write:
        for result in results:
            folders = {
                r.seed: options.out / run_name(result.key, r.seed) for r in result.runs
            }
            ship_policy(result, folders, stored)
            stored = stored.having(result)
        stored.save(RESULTS)
