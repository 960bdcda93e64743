"""`manip list`: names of tasks, robots, algorithms, recipes, policies and tastes."""

import json
from collections.abc import Sequence
from dataclasses import dataclass

from rich.table import Table
from rich.text import Text

from manip.agents.policy import shipped_policies
from manip.agents.registry import algorithm_names
from manip.envs.external_task import external_names
from manip.envs.task_registry import task_names
from manip.evaluation.stress_suite import suite_names
from manip.io.printable import printable
from manip.preferences.tastes import shipped_tastes
from manip.programs import cli
from manip.programs.output import console
from manip.robot_config import CONTROLLERS, ROBOTS
from manip.training.randomisation import randomisation_names
from manip.training.recipes import recipe_names


@dataclass(frozen=True)
class List:
    """List tasks, robots, algorithms, action spaces, recipes, policies and tastes."""

    json: bool = False
    """Print JSON instead of a table."""


def main(arguments: Sequence[str]) -> int:
    """Print the names of everything that can be chosen."""
    options = cli.parse(List, arguments, "manip list")
    names = catalogue()
    if options.json:
        print(json.dumps(names, indent=2))
    else:
        console().print(_table(names))
    return 0


def catalogue() -> dict[str, list[str]]:
    """Category (tasks, robots, ...) -> all names."""
    return {
        "tasks": task_names(),
        "external_tasks": external_names(),
        "robots": list(ROBOTS),
        "algorithms": algorithm_names(),
        "action_spaces": list(CONTROLLERS),
        "recipes": recipe_names(),
        "policies": list(shipped_policies()),
        "tastes": shipped_tastes(),
        "perturbations": suite_names(),
        "randomisations": randomisation_names(),
    }


def _table(names: dict[str, list[str]]) -> Table:
    table = Table(show_header=False)
    for kind, kind_names in names.items():
        listing = ", ".join(kind_names) or "none"
        table.add_row(kind.replace("_", " "), Text(printable(listing)))
    return table
