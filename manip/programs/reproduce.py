"""`manip reproduce`: rerun shipped recipes and compare with the shipped results."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console

from manip.agents.policy import SHIPPED, PolicyCard, load_policy, shipped_policies
from manip.cpus import machine
from manip.errors import UserError, at_least, check_choice, unknown
from manip.evaluation.shipped_results import (
    RESULTS,
    Key,
    Result,
    Results,
    Run,
    load_results,
    percent,
)
from manip.io.atomic_files import write_text
from manip.programs import cli
from manip.programs.evaluate import Evaluate, evaluate
from manip.programs.results import table
from manip.robot_config import ROBOTS
from manip.training.build import imitates
from manip.training.config import TrainConfig, recipes
from manip.training.run import RunResult, train_or_resume
from manip.training.terminal import TerminalProgress
from manip.versions import versions

STOPPED = 3
"""Exit code: interrupted and saved."""

WORTH = 0.9
"""Rate of held success from which a policy is shipped."""


@dataclass(frozen=True)
class Reproduce:
    """Rerun shipped recipes, evaluate in stock robosuite, compare with the results.

    Every recipe is trained with seeds 0, 1, ...; its held success agrees with the
    shipped result of the same seed where their 95 % intervals meet. What was
    interrupted goes on with the same command. The exit code is 1 if anything is worse
    than its shipped result.
    """

    what: Annotated[tuple[str, ...], tyro.conf.Positional]
    """Tasks (Lift: all of its recipes), recipes (lift-sac), or all."""
    robot: str | None = None
    """This arm alone; unless given, the recipe's own and those that have a result."""
    seeds: int = 3
    """Seeds of each recipe."""
    episodes: int = 100
    """Episodes of each evaluation."""
    out: Path = Path("runs/reproduce")
    """Folder of the runs."""
    json: Path | None = None
    """Write what was found to this file, too."""
    write: bool = False
    """Make what was found the shipped results (assets/results.yaml), and the best
    policy the shipped one (assets/policies) if it succeeds well enough."""


def main(arguments: Sequence[str]) -> int:
    """Train, evaluate, compare: 0 agrees, 1 worse, 3 stopped and saved on the way."""
    options = cli.parse(Reproduce, arguments, "manip reproduce")
    for name in ("seeds", "episodes"):
        at_least(1, f"--{name}", getattr(options, name))
    stored = load_results()
    found: list[Result] = []
    for config in chosen(options, stored):
        runs = tuple(_runs(config, options, stored))
        if len(runs) < options.seeds:
            return STOPPED
        found.append(Result(*_key(config), imitates(config), machine(), runs))
        _keep(found, options, stored)
    Console().print(table(stored, found))
    worse = [_name(result) for result in found if "worse" in _verdicts(result, stored)]
    if worse:
        Console().print(f"worse than its result: {', '.join(worse)}", style="red")
    return int(bool(worse))


def chosen(options: Reproduce, stored: Results) -> list[TrainConfig]:
    """The recipes that were asked for, with each of their arms.

    Raises:
        UserError: no such recipe or arm.
    """
    known = recipes()
    if options.robot:
        check_choice("robot", options.robot, ROBOTS)
    names = {*known, *(config.task for config in known.values()), "all"}
    if not options.what:
        raise UserError(f"reproduce what? known recipes: {', '.join(sorted(names))}")
    for asked in options.what:
        if asked not in names:
            raise unknown("recipe", asked, sorted(names))
    return [
        recipes(robot)[name]
        for name, config in known.items()
        if {"all", name, config.task} & set(options.what)
        for robot in _robots(config, options, stored)
    ]


def _robots(config: TrainConfig, options: Reproduce, stored: Results) -> list[str]:
    if options.robot:
        return [options.robot]
    others = {
        result.robot
        for result in stored.results
        if (result.task, result.algo) == (config.task, config.algo)
    }
    return [config.robot, *sorted(others - {config.robot})]


def _runs(config: TrainConfig, options: Reproduce, stored: Results) -> Iterator[Run]:
    """A run a seed; fewer if it is stopped."""
    console = Console()
    for seed in range(options.seeds):
        name = _run_name(_key(config), seed)
        console.rule(name)
        run_config = replace(config, seed=seed, out=options.out / name)
        with TerminalProgress() as progress:
            result = train_or_resume(run_config, callback=progress)
        if not result.finished:
            return
        run = _evaluated(result, seed, options.episodes)
        console.print(f"{name}: {_comparison(run, _key(config), stored)}")
        yield run


def _evaluated(result: RunResult, seed: int, episodes: int) -> Run:
    evaluation = evaluate(Evaluate(result.folder, "stock", episodes))
    return Run(
        seed=seed,
        success_held=round(evaluation.success["success_held"].rate * episodes),
        episodes=episodes,
        env_steps=result.env_steps,
        minutes=round(result.seconds / 60, 1),
    )


def _run_name(key: Key, seed: int) -> str:
    return "-".join((*key, str(seed)))


def _key(config: TrainConfig) -> Key:
    return config.task, config.robot, config.algo


def _name(result: Result) -> str:
    return " ".join(result.key)


def verdict(run: Run, stored: Run | None) -> str:
    """How a run compares with the shipped one of its seed."""
    if stored is None:
        return "new"
    if run.rate.low > stored.rate.high:
        return "better"
    return "worse" if run.rate.high < stored.rate.low else "agrees"


def _verdicts(result: Result, stored: Results) -> list[str]:
    return [verdict(run, stored.run(result.key, run.seed)) for run in result.runs]


def _comparison(run: Run, key: Key, stored: Results) -> str:
    before = stored.run(key, run.seed)
    beside = f", shipped {percent(before.rate)}" if before else ""
    return f"held {percent(run.rate)} %{beside}: {verdict(run, before)}"


def _keep(found: Sequence[Result], options: Reproduce, stored: Results) -> None:
    if options.json:
        record = {
            "results": [_record(result, stored) for result in found],
            "versions": versions(),
        }
        write_text(options.json, json.dumps(record, indent=2) + "\n")
    if options.write:
        for result in found:
            _ship_policy(result, options.out, stored)
            stored = stored.having(result)
        stored.save(RESULTS)


def _ship_policy(result: Result, out: Path, stored: Results) -> None:
    """Ship the best run's policy, if worth it and better than another algorithm's."""
    best = max(result.runs, key=lambda run: run.rate.rate)
    policy = load_policy(out / _run_name(result.key, best.seed))
    if best.rate.rate >= WORTH and best.rate.rate > _rival(policy.card, stored):
        policy.save(SHIPPED / policy.card.name)


def _rival(card: PolicyCard, stored: Results) -> float:
    """What the shipped policy reaches, if it is of another algorithm."""
    folder = shipped_policies().get(card.name)
    before = load_policy(folder).card if folder else card
    run = stored.run((before.task, before.robot, before.algo), before.seed)
    return run.rate.rate if run and before.algo != card.algo else 0.0


def _record(result: Result, stored: Results) -> dict[str, Any]:
    runs = [_with_stored(run, stored.run(result.key, run.seed)) for run in result.runs]
    return result.plain() | {"runs": runs}


def _with_stored(run: Run, stored: Run | None) -> dict[str, Any]:
    return asdict(run) | {
        "rate": asdict(run.rate),
        "shipped": asdict(stored.rate) if stored else None,
        "verdict": verdict(run, stored),
    }
