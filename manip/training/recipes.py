"""Tuned options of runs, by task and algorithm: the files in assets/recipes."""

from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from manip.agents.policy_card import CAMERAS, Observe
from manip.envs.task_registry import task_names
from manip.io.dataclass_values import build
from manip.io.yaml_files import read_yaml
from manip.training.config import NESTED, SCALE, TrainConfig, from_dict

STEPS = (
    *("steps", "eval_every"),
    *("random_steps", "critic_steps", "initial_steps"),
)
"""Options that are numbers of control steps."""

PER_STEP = ("updates_per_step",)
"""Options that are numbers of updates per control step."""


def recipe_names() -> list[str]:
    """Return the names `<task>-<algo>[-cameras]` of the recipes that are shipped."""
    paths = (files("manip.assets") / "recipes").iterdir()
    names = [path.name.removesuffix(".yaml") for path in paths]
    return sorted(name for name in names if "-" in name)


def recipe_choice(name: str) -> tuple[str, str, Observe]:
    """Split a recipe's name: task in lower case, algorithm, observation."""
    task, method = name.split("-", 1)
    algo = method.removesuffix(CAMERAS)
    return task, algo, "state" if algo == method else "cameras"


def recipes(robot: str | None = None) -> dict[str, TrainConfig]:
    """Return the tuned recipes of all installed tasks: name -> options."""
    tasks = {task.lower(): task for task in task_names()}
    choices = {name: recipe_choice(name) for name in recipe_names()}
    return {
        name: recipe(tasks[task], algo, robot, observe=observe)
        for name, (task, algo, observe) in choices.items()
        if task in tasks
    }


def recipe(
    task: str,
    algo: str,
    robot: str | None = None,
    controller: str | None = None,
    observe: Observe = "state",
) -> TrainConfig:
    """Return the tuned options of a task and an algorithm, or the defaults.

    All tasks of another library share one recipe, and so do all tasks without a recipe
    of their own for cameras. A recipe's action_scale is of its own
    controller, and is left out with another one.

    Args:
        robot: the arm, if not the recipe's own; a recipe may set other options for it,
            under `robots`.
        controller: the action space, if not the recipe's own.
        observe: what the actor sees; see `TrainConfig`.

    Raises:
        UserError: unknown algorithm.
    """
    values = dict(_values(task, algo, observe))
    values = _merge(values, values.pop("robots", {}).get(robot, {}))
    if scales_other_actions(task, algo, controller):
        values["agent"] = {k: v for k, v in values["agent"].items() if k != SCALE}
    chosen = {"robot": robot, "controller": controller}
    values |= {option: value for option, value in chosen.items() if value}
    return from_dict({"task": task, "algo": algo, "observe": observe} | values)


def with_labels(config: TrainConfig, folder: Path) -> TrainConfig:
    """Return the options of a run that learns from preferences in a folder.

    Those of its algorithm in the recipe `preferences` replace the options given; a task
    may have others, under `tasks`.
    """
    values = dict(_shipped("preferences").get(config.algo, {}))
    values = _merge(values, values.pop("tasks", {}).get(config.task, {}))
    labels = replace(config.labels, **values.pop("labels", {}))
    changes = values.pop("agent", {})
    if config.controller != "OSC_POSE":  # its action_scale is for that one
        changes = {name: v for name, v in changes.items() if name != SCALE}
    agent = build(type(config.agent), asdict(config.agent) | changes)
    return replace(config, preferences=folder, labels=labels, agent=agent, **values)


def _merge(values: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    """Options, some of them replaced by others; of groups, option by option."""
    groups = {name: values.get(name, {}) | own.get(name, {}) for name in NESTED}
    return values | own | {name: group for name, group in groups.items() if group}


def for_gpu(config: TrainConfig) -> TrainConfig:
    """Return a recipe's options for thousands of environments on a GPU.

    Those of its algorithm in the recipe `gpu` replace the options given, if there are
    any. The number of updates stays: numbers of control steps grow with the rollout.
    """
    values = dict(_shipped("gpu").get(config.algo, {}))
    agent = replace(config.agent, **values.pop("agent", {}))
    larger = replace(config, agent=agent, **values)
    factor = _rollout_steps(larger) / _rollout_steps(config)
    agent = replace(agent, **_times(agent, STEPS, factor))
    agent = replace(agent, **_times(agent, PER_STEP, 1 / factor))
    return replace(larger, agent=agent, **_times(larger, STEPS, factor))


def _rollout_steps(config: TrainConfig) -> int:
    return config.num_envs * getattr(config.agent, "rollout_length", 1)


def _times(options: Any, names: Sequence[str], factor: float) -> dict[str, Any]:
    """The options of these names, multiplied; whole numbers stay whole."""
    values = {n: getattr(options, n) for n in names if hasattr(options, n)}
    return {n: type(v)(v * factor) for n, v in values.items()}


def scales_other_actions(task: str, algo: str, controller: str | None) -> bool:
    """Whether a recipe has an action_scale, but for another controller than this."""
    values = _shipped(f"{task.lower()}-{algo}")
    own = values.get("controller", "OSC_POSE")
    return controller not in (None, own) and SCALE in values.get("agent", {})


def _values(task: str, algo: str, observe: Observe) -> dict[str, Any]:
    """The options in the file of a recipe; none if there is no such file."""
    if observe == "cameras":
        return _shipped(f"{task.lower()}-{algo}{CAMERAS}") or _shipped("cameras")
    return _shipped(task.split("/")[0] if "/" in task else f"{task.lower()}-{algo}")


@cache
def _shipped(name: str) -> dict[str, Any]:
    path = files("manip.assets") / "recipes" / f"{name}.yaml"
    return read_yaml(Path(str(path))) if path.is_file() else {}
