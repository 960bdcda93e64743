"""`manip evaluate`: measure a policy's success over many episodes."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import torch
import tyro
from rich.console import Console
from rich.progress import Progress

from manip.agents.policy import Policy, load_policy
from manip.envs.external_task import library_of
from manip.envs.make_batch import Backend
from manip.envs.task import Task
from manip.envs.task_registry import load_task_named_by
from manip.errors import at_least
from manip.evaluation.episodes import Episode
from manip.evaluation.report import Evaluation, summarise, table
from manip.evaluation.runners import EpisodeSettings, evaluate_policy
from manip.io.atomic_files import write_text
from manip.io.output_paths import check_output
from manip.programs import cli
from manip.programs.output import console
from manip.sim.scene import Fidelity
from manip.versions import versions

MOST_EPISODES = 100_000
"""Native episodes run side by side, in memory."""


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
    """Run folder, policy folder, or name of a shipped policy (see `manip list`)."""
    env: Backend = "stock"
    """Backend that simulates the episodes. stock: robosuite.make(...) itself, or the
    library that defines the task; native: the batch engine, many times faster."""
    episodes: int = 100
    """Number of episodes. More episodes narrow the intervals and take longer."""
    seed: int = 0
    """Seed of the episodes' random streams. Two seeds have no episode in common."""
    fidelity: Fidelity = "exact"
    """Physics of the native engine: exact as stock robosuite, or fast."""
    json: Path | None = None
    """File for the result as JSON, besides the table."""


def main(arguments: Sequence[str]) -> int:
    """Evaluate, write the JSON file, print the table."""
    options = cli.parse(Evaluate, arguments, "manip evaluate")
    if options.json:
        check_output(options.json, "--json")
    torch.set_num_threads(1)
    result = evaluate(options)
    if options.json:
        write_text(options.json, result.to_json())
    console().print(table(result))
    return 0


def evaluate(options: Evaluate) -> Evaluation:
    """Run the episodes and summarise them.

    Raises:
        UserError: an option is out of range, or there is no such policy.
    """
    cli.check_range("--episodes", options.episodes, 1, MOST_EPISODES)
    at_least(0, "--seed", options.seed)
    policy = load_policy(options.run)
    card = policy.card
    task = load_task_named_by(options.run, card.task)
    settings = _settings(options, policy, task)
    began = time.monotonic()
    episodes = _run(policy, settings, f"{options.env} {library_of(card.task)}")
    return Evaluation(
        task=card.task,
        robot=card.robot,
        algo=card.algo,
        env=options.env,
        fidelity=settings.fidelity,
        episodes=options.episodes,
        seed=options.seed,
        purpose=settings.purpose.name.lower(),
        env_steps_trained=card.env_steps,
        **summarise(episodes, task.milestone_names),
        seconds=time.monotonic() - began,
        versions=versions(),
    )


def _settings(options: Evaluate, policy: Policy, task: Task) -> EpisodeSettings:
    return EpisodeSettings(
        task=task,
        robot=policy.card.robot_config,
        observation=policy.card.observation,
        episodes=options.episodes,
        seed=options.seed,
        backend=options.env,
        fidelity="exact" if options.env == "stock" else options.fidelity,
    )


def _run(policy: Policy, settings: EpisodeSettings, name: str) -> list[Episode]:
    """Run the episodes, with a progress bar on stderr."""
    with Progress(console=Console(stderr=True), transient=True) as bar:
        running = bar.add_task(name, total=settings.episodes)
        return evaluate_policy(policy, settings, lambda n: bar.advance(running, n))
