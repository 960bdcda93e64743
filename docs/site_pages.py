"""Pages of the site that are generated from the package: see `write_pages`."""

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from help_pages import Help, Row, definitions, help_of

from manip.agents.registry import algorithm_names
from manip.envs.task_registry import load_task, task_names
from manip.programs.main import PROGRAMS

FILMS = Path(__file__).parent / "static" / "films"
"""Videos of the shipped policies, written by `make films`."""

GALLERY = """\
Each video shows one episode of the shipped policy (`manip render TASK`), at 20 control
steps per second. `manip evaluate TASK` measures its success in stock robosuite, and
`manip train --task TASK` trains a policy of your own."""
"""Text above the tasks."""

MODULES = {
    "Environments": (
        *("manip.envs.make_batch", "manip.envs.adapters.torchrl"),
        *(
            "manip.envs.adapters.gymnasium",
            "manip.envs.adapters.gymnasium_observations",
        ),
        *("manip.envs.adapters.sb3", "manip.envs.adapters.dm_env"),
        *("manip.envs.task_batch", "manip.envs.time_step", "manip.observation"),
        *("manip.robot_config", "manip.cameras", "manip.looks"),
    ),
    "Tasks": (
        *("manip.envs.task", "manip.envs.task_registry", "manip.envs.task_check"),
        *("manip.envs.visible_measures", "manip.sim.sensors", "manip.rewards.kernels"),
        *("manip.rewards.compose", "manip.rewards.reward_function"),
    ),
    "Training": (
        *("manip.training.config", "manip.training.recipes", "manip.training.run"),
        *("manip.training.progress", "manip.training.final_evaluation"),
    ),
    "Algorithms": (
        *("manip.agents.agent", "manip.agents.registry", "manip.agents.policy"),
        *("manip.agents.policy_card", "manip.agents.networks", "manip.agents.replay"),
        *("manip.agents.trajectory", "manip.agents.value_targets"),
    ),
    "Evaluation": (
        *("manip.evaluation.episodes", "manip.evaluation.report"),
        *("manip.evaluation.statistics", "manip.evaluation.aggregates"),
        "manip.evaluation.comparison",
    ),
    "Preferences": (
        *("manip.preferences.clips", "manip.preferences.comparisons"),
        *("manip.preferences.labellers", "manip.preferences.tastes"),
        *("manip.preferences.reward_model", "manip.preferences.queries"),
    ),
    "Simulation": (
        *("manip.sim.engine", "manip.sim.batch_engine", "manip.sim.scene"),
        *("manip.sim.renderer", "manip.sim.scene_cameras"),
    ),
    "Errors and files": ("manip.errors", "manip.io.atomic_files", "manip.io.checksums"),
}
"""Title of a page of the reference -> the modules on it."""


def write_pages(folder: Path) -> None:
    """Write the pages of all tasks, programs, algorithms and modules into a folder."""
    _write(folder / "gallery.md", gallery_page())
    for name in PROGRAMS:
        _write(folder / "programs" / f"{name}.md", program_page(name))
    for name in algorithm_names():
        _write(folder / "algorithms" / f"{name}.md", algorithm_page(name))
    for title, modules in MODULES.items():
        page = reference_page(title, modules)
        _write(folder / "reference" / f"{title.lower().replace(' ', '-')}.md", page)


def gallery_page() -> str:
    """What each task is, with a video of its shipped policy."""
    sections = [_task_section(name) for name in task_names()]
    return "\n\n".join(["# Gallery of tasks", GALLERY, *sections])


def program_page(name: str) -> str:
    """Purpose, usage and options of a program."""
    text = help_of(name)
    if name == "benchmark":
        for kind in ("task", "gpu"):
            boxes = help_of(name, [kind]).boxes
            text.boxes.update(_named(f"benchmark {kind}", boxes))
    if name == "train":
        text.boxes.pop("agent options")
    return "\n\n".join([f"# manip {name}", *_program_parts(name, text)])


def algorithm_page(name: str) -> str:
    """The options of `manip train --algo NAME` that the algorithm reads."""
    boxes = help_of("train", ["--task", "Reach", "--algo", name]).boxes
    lines = (
        f"# {name}",
        f"`manip train --algo {name}` has the [options of all algorithms]"
        "(../programs/train.md) and those below. The values are those of Reach's "
        "recipe, or the algorithm's defaults.",
        definitions(boxes["agent options"]),
    )
    return "\n\n".join(lines)


def reference_page(title: str, modules: Sequence[str]) -> str:
    """The docstrings of modules, one section a module."""
    sections = [
        f"## {module}\n\n```{{eval-rst}}\n.. automodule:: {module}\n```\n"
        for module in modules
    ]
    return "\n".join([f"# {title}\n", *sections])


def _task_section(name: str) -> str:
    task = load_task(name)
    video = f"../_static/films/{name}.mp4"
    film = f'<video src="{video}" autoplay loop muted playsinline controls></video>'
    text = sys.modules[type(task).__module__].__doc__ or ""
    parts = [
        f"## {name}",
        film if (FILMS / f"{name}.mp4").exists() else "",
        f"```text\n{text.strip()}\n```",
        f"Milestones: {', '.join(task.milestone_names)}. "
        f"Horizon: {task.horizon} control steps.",
    ]
    return "\n\n".join(filter(None, parts))


def _program_parts(name: str, text: Help) -> list[str]:
    sections = [
        f"## {_capital(box)}\n\n{definitions(rows)}" for box, rows in text.boxes.items()
    ]
    usage = f"```text\n{text.usage}\n```"
    return [f"{_capital(PROGRAMS[name])}.", usage, text.description, *sections]


def _named(prefix: str, boxes: Mapping[str, list[Row]]) -> dict[str, list[Row]]:
    return {f"{prefix}: {title}": rows for title, rows in boxes.items()}


def _capital(text: str) -> str:
    return f"{text[0].upper()}{text[1:]}"


def _write(path: Path, text: str) -> None:
    """Write a page that has changed, so that Sphinx reads only those again."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")
