"""`manip list`: what there is to choose from."""

import json
from collections.abc import Sequence
from dataclasses import dataclass

from rich.console import Console
from rich.table import Table

from manip.agents.policy import shipped_policies
from manip.agents.registry import algorithm_names
from manip.envs.backends.external_batch import external_names
from manip.envs.task_registry import task_names
from manip.programs import cli
from manip.robot_config import CONTROLLERS, ROBOTS
from manip.training.config import recipe_names


@dataclass(frozen=True)
class List:
    """Name the tasks, robots, algorithms, action spaces, recipes and policies."""

    json: bool = False
    """Print them as JSON."""


def main(arguments: Sequence[str]) -> int:
    """Print what exists."""
    options = cli.parse(List, arguments, "manip list")
    found = catalogue()
    if options.json:
        print(json.dumps(found, indent=2))
        return 0
    shown = Table(show_header=False)
    for kind, names in found.items():
        shown.add_row(kind.replace("_", " "), ", ".join(names) or "none")
    Console().print(shown)
    return 0


def catalogue() -> dict[str, list[str]]:
    """Kind -> names of all that exists."""
    return {
        "tasks": task_names(),
        "external_tasks": external_names(),
        "robots": list(ROBOTS),
        "algorithms": algorithm_names(),
        "action_spaces": list(CONTROLLERS),
        "recipes": recipe_names(),
        "policies": list(shipped_policies()),
    }
