"""`manip train`: train a policy from a tuned recipe."""

import contextlib
import io
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, TypeVar

import tyro

from manip.agents.policy_card import Observe
from manip.cluster.ray_collectors import ray_collectors
from manip.cluster.seeds import seeds_folder, train_seeds
from manip.envs.external_task import ExternalTask
from manip.envs.task_registry import load_task, load_task_named_by
from manip.errors import UserError, check_choice
from manip.io.option_ranges import Range
from manip.programs import cli
from manip.robot_config import CONTROLLERS, ROBOTS
from manip.training.config import TrainConfig, recorded
from manip.training.initial_policy import observation_of, starting_from
from manip.training.placement import learns_on_gpu
from manip.training.recipes import for_gpu, recipe, scales_other_actions, with_labels
from manip.training.run import train
from manip.training.run_parts import Place, here
from manip.training.terminal import TerminalProgress

_TEXT_OPTIONS = {
    *("--task", "--algo", "--robot", "--out", "--wandb", "--init", "--teacher"),
    "--dataset",
    *("--agent.reference", "--preferences", "--labels.taste", "--ray"),
}
"""Options whose value is text and must not be rewritten as a number."""


Config = TypeVar("Config", bound=TrainConfig)

WAITING = 75
"""Exit code of a run that waits for answers: sysexits' "temporary failure, retry"."""


@dataclass(frozen=True)
class Train(TrainConfig):
    """Train a policy on the batch engine; a tuned recipe sets the defaults."""

    ray: str | None = None
    """Step the environments on the Ray cluster at this address (host:port), or on the
    one that this machine belongs to (auto): each of --collectors takes one CPU there.
    It does not change the run. Needs the package ray on all machines."""
    seeds: Annotated[tuple[int, ...], Range(0, 2**32 - 1)] = ()
    """Train once with each of these seeds, in parallel, in the folders OUT/seed0, ...
    The same command continues runs that were interrupted; `manip compare OUT` shows
    mean and range over the seeds."""


@dataclass(frozen=True)
class _Start:
    """The options that choose the recipe, which sets all others."""

    task: str = "Lift"
    algo: str = "sac"
    robot: str | None = None
    controller: str | None = None
    observe: str = "state"
    out: Path | None = None
    resume: bool = False
    init: str | None = None
    preferences: Path | None = None
    engine: str = "native"
    device: str | None = None


def main(arguments: Sequence[str]) -> int:
    """Train; 0 when the run finished, 3 when it was stopped and saved before, 75 when
    it was saved and waits for people to compare clips (`manip label`).
    """
    options = _options(Train, arguments)
    config, task = _without_place(options), load_task(options.task)
    if options.seeds:
        return _train_seeds(config, options)
    with _place(options.ray) as place, TerminalProgress() as progress:
        if isinstance(task, ExternalTask):
            progress.say(f"manip: {task.notice}")
        result = train(config, callback=progress, place=place)
        if result.finished:
            progress.say(f"a page about it: manip report {config.folder}")
            progress.say(f"trained policy: {result.policy}")
    if result.waiting:
        return WAITING
    return 0 if result.finished else 3


def _train_seeds(config: TrainConfig, options: Train) -> int:
    """Train with each seed; 0 if all have finished, 1 if one failed, 3 otherwise."""
    if options.ray is not None:
        raise UserError("--seeds trains on this machine: use `manip sweep` with --ray")
    outcomes = train_seeds(config, options.seeds)
    ends = [outcome.status for outcome in outcomes.values()]
    out = seeds_folder(config)
    print(
        f"trained policies: {out}; compare them: manip compare {out}", file=sys.stderr
    )
    if "failed" in ends:
        return 1
    return 0 if ends.count("finished") == len(options.seeds) else 3


def config_of(arguments: Sequence[str]) -> TrainConfig:
    """The options of a command line, with the recipe's for those that it leaves out.

    Raises:
        UserError: an option, a value, a task or a robot that does not exist.
        SystemExit: after --help.
    """
    return _options(TrainConfig, arguments)


def _options(kind: type[Config], arguments: Sequence[str]) -> Config:
    arguments = list(_with_whole_numbers(arguments))
    default = kind(**_values(_defaults(arguments)))
    options = cli.parse(kind, arguments, "manip train", default)
    load_task(options.task)
    check_choice("robot", options.robot, ROBOTS)
    return options


def _without_place(options: Train) -> TrainConfig:
    return TrainConfig(**_values(options))


def _values(config: TrainConfig) -> dict[str, Any]:
    return {field.name: getattr(config, field.name) for field in fields(TrainConfig)}


def _place(ray: str | None) -> AbstractContextManager[Place]:
    return nullcontext(here) if ray is None else ray_collectors(ray)


def _with_whole_numbers(arguments: Sequence[str]) -> Iterator[str]:
    """Write numbers such as 1e6 or 2.5e5 in full, which whole numbers may be, too."""
    option = ""
    for argument in arguments:
        if argument.startswith("--"):
            option, equals, value = argument.partition("=")
            yield f"{option}{equals}{_in_full(value, option)}"
        else:
            yield _in_full(argument, option)


def _in_full(value: str, option: str) -> str:
    form = re.fullmatch(r"\d+(\.\d+)?[eE]\+?\d{1,2}", value)
    if option.replace("_", "-") in _TEXT_OPTIONS or not form:
        return value
    return str(int(float(value))) if float(value).is_integer() else value


def _defaults(arguments: Sequence[str]) -> TrainConfig:
    """The recipe of task, algorithm and arm; or the options of a run to resume."""
    with contextlib.redirect_stderr(io.StringIO()):
        try:
            start, _ = tyro.cli(
                _Start, args=list(arguments), return_unknown_args=True, add_help=False
            )
        except SystemExit:
            return TrainConfig()  # parsing all options reports the mistake
    if start.resume:
        return _recorded(start.out)
    load_task(start.task)
    known = start.controller in CONTROLLERS
    if known and scales_other_actions(start.task, start.algo, start.controller):
        print(
            f"manip: the recipe's action_scale is not used with {start.controller}",
            file=sys.stderr,
        )
    initial = observation_of(start.init) if start.init else "state"
    observe: Observe = "cameras" if start.observe == "cameras" else initial
    chosen = start.task, start.algo, start.robot, start.controller
    config = recipe(*chosen, observe)
    if start.preferences is not None:
        config = with_labels(config, start.preferences)
    if start.init is not None:
        config = starting_from(config, start.init)
    on_gpu = start.engine == "warp" and start.device != "cpu"
    there = replace(config, engine="warp" if on_gpu else "native")
    return for_gpu(config) if learns_on_gpu(there) else config


def _recorded(out: Path | None) -> TrainConfig:
    path = (out or Path()) / "config.yaml"
    if out is None or not path.is_file():
        raise UserError(f"--resume needs --out with a run folder; there is no {path}")
    config = replace(recorded(out), out=out, resume=True)
    load_task_named_by(out, config.task)
    return config
