"""`manip evaluate`: measure a policy's success over many episodes."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.progress import Progress

from manip.agents.policy import Policy, load_policy
from manip.envs.external_task import library_of
from manip.envs.task_registry import load_task_named_by
from manip.errors import at_least
from manip.evaluation.episodes import Episode
from manip.evaluation.report import Evaluation, summarise, table
from manip.evaluation.runners import Where, native_episodes, stock_episodes, timed
from manip.io.atomic_files import write_text
from manip.programs import cli
from manip.sim.scene import Fidelity
from manip.versions import versions


@dataclass(frozen=True)
class Evaluate:
    """Measure a policy's success on its task.

    Episodes start from seed, seed + 1, ...; the policy acts without noise. Success is
    reported once (ever), at the end, and held (the last 10 control steps), each with
    its Wilson 95 % interval.
    """

    run: Annotated[Path, tyro.conf.Positional]
    """Run folder, folder with a policy, or name of a shipped one (see `manip list`)."""
    env: Where = "stock"
    """stock: robosuite.make(...), or the task's own library; native: batch engine."""
    episodes: int = 100
    """Number of episodes."""
    seed: int = 0
    """Seed of the first episode."""
    fidelity: Fidelity = "exact"
    """Physics of the native engine."""
    json: Path | None = None
    """Write the result to this file, too."""


def main(arguments: Sequence[str]) -> int:
    """Evaluate and print a table."""
    options = cli.parse(Evaluate, arguments, "manip evaluate")
    result = evaluate(options)
    Console().print(table(result))
    if options.json:
        write_text(options.json, result.to_json())
    return 0


def evaluate(options: Evaluate) -> Evaluation:
    """Run the episodes and sum them up."""
    at_least(1, "--episodes", options.episodes)
    at_least(0, "--seed", options.seed)
    policy = load_policy(options.run)
    card = policy.card
    task = load_task_named_by(options.run, card.task)
    episodes, seconds = timed(lambda: _episodes(options, policy))
    return Evaluation(
        task=card.task,
        robot=card.robot,
        algo=card.algo,
        env=options.env,
        fidelity="exact" if options.env == "stock" else options.fidelity,
        episodes=options.episodes,
        seed=options.seed,
        env_steps_trained=card.env_steps,
        **summarise(episodes, task.milestone_names),
        seconds=seconds,
        versions=versions(),
    )


def _episodes(options: Evaluate, policy: Policy) -> Sequence[Episode]:
    card = policy.card
    rig = card.robot_config
    asked = (card.task, policy, options.episodes, options.seed)
    if options.env == "native":
        return native_episodes(*asked, rig, options.fidelity, card.layout)
    with Progress(console=Console(stderr=True), transient=True) as bar:
        running = bar.add_task(f"stock {library_of(card.task)}", total=options.episodes)
        tell = partial(bar.advance, running)
        return stock_episodes(*asked, rig, tell, card.layout)
