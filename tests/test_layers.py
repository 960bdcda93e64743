"""Imports of the sources point down: errors at the bottom, scripts on top."""

import ast
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent

TOWER = (
    {"errors"},
    {"arrays", "deploy", "untrusted_code"},
    {"compiled", "cpus", "observation", "plugins", "robot_config", "versions"},
    {"cameras", "looks"},
    {"io"},
    {"rewards"},
    {"sim"},
    {"envs"},
    {"agents", "evaluation", "tasks"},
    {"data", "preferences"},
    {"training"},
    {"cluster"},
    {"benchmarks", "reports", "studies"},
    {"programs"},
    {"__main__"},
)
"""Rooms of manip from the bottom up; rooms of one floor do not import each other."""

APART = {("agents", "envs"), ("agents", "sim")}
"""Imports that would point down, and are forbidden all the same."""

HOME = {
    "mujoco": ("manip/sim",),
    "warp": ("manip/sim/warp",),
    "mujoco_warp": ("manip/sim/warp",),
    "numba": ("manip/sim", "manip/compiled.py"),
    "llvmlite": ("manip/sim",),
    "robosuite": ("manip/sim/robosuite_factory.py", "tasks/scenes"),
    "dm_control": ("manip/sim/external/dm_control_sim.py",),
    "tyro": ("manip/programs",),
    "flask": ("manip/preferences/page",),
    "jinja2": ("manip/reports",),
    "markupsafe": ("manip/reports",),
    "envpool": ("manip/benchmarks",),
    "onnx": ("manip/agents/exports.py",),
    "onnxruntime": ("manip/deploy/exported_policy.py", "manip/agents/exports.py"),
    "dm_env": ("manip/envs/adapters/dm_env.py",),
    "gymnasium": (
        *("manip/envs/adapters", "manip/benchmarks"),
        "manip/data/minari_files.py",
    ),
    "ray": ("manip/cluster/ray_cluster.py", "manip/cluster/ray_task.py"),
    "stable_baselines3": ("manip/envs/adapters/sb3.py", "manip/benchmarks"),
}
"""Library -> the only places that import it."""


def sources(*folders: str) -> Iterator[Path]:
    for folder in folders:
        yield from sorted((ROOT / folder).rglob("*.py"))


def module_of(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    if parts[0] == "tasks":  # installed inside manip, by a link
        parts = ("manip", *parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_of(path): path for path in sources("manip", "tasks", "scripts")}


def imports(path: Path) -> set[str]:
    """Modules that a file imports anywhere in it, by their full names."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            for alias in node.names:
                inside = f"{node.module}.{alias.name}"
                names.add(inside if inside in MODULES else str(node.module))
    return names


GRAPH = {name: imports(path) for name, path in MODULES.items()}


def room(module: str) -> str:
    """manip.sim.batch_engine -> sim; tasks.lift -> tasks; the bare package -> manip."""
    parts = module.split(".")
    return parts[1] if parts[0] == "manip" and len(parts) > 1 else parts[0]


def floor(name: str) -> int:
    return next(level for level, rooms in enumerate(TOWER) if name in rooms)


def crossings(package: str) -> Iterator[tuple[str, str]]:
    """(module, imported) pairs inside manip that leave a room."""
    for module, imported in GRAPH.items():
        for name in imported:
            both = module.startswith(f"{package}."), name.startswith(f"{package}.")
            if all(both) and room(module) != room(name):
                yield module, name


def test_every_room_has_a_floor() -> None:
    rooms = {room(name) for name in MODULES if name.startswith("manip.")}
    assert rooms == set().union(*TOWER)


def test_imports_point_down() -> None:
    pairs = list(crossings("manip"))
    upward = [
        (module, name)
        for module, name in pairs
        if floor(room(module)) <= floor(room(name))
    ]
    assert len(pairs) > 20
    assert upward == []


def test_agents_import_no_environment() -> None:
    pairs = crossings("manip")
    assert [(a, b) for a, b in pairs if (room(a), room(b)) in APART] == []


def test_manip_imports_no_task() -> None:
    users = {module for module, names in GRAPH.items() if "tasks" in map(room, names)}
    assert {room(module) for module in users} == {"tasks"}


def test_tasks_import_no_learning() -> None:
    allowed = {
        *("tasks", "envs", "rewards", "sim"),
        *("arrays", "observation", "robot_config", "errors"),
    }
    for module, names in GRAPH.items():
        if room(module) == "tasks":
            ours = {room(name) for name in names if name in MODULES}
            assert ours <= allowed, module


def test_scripts_only_start_programs() -> None:
    for module, names in GRAPH.items():
        if room(module) == "scripts":
            ours = {room(name) for name in names if name in MODULES}
            assert ours <= {"programs"}, module


@pytest.mark.parametrize("library", HOME)
def test_libraries_are_imported_in_their_places_only(library: str) -> None:
    for module, names in GRAPH.items():
        if any(name.split(".")[0] == library for name in names):
            place = MODULES[module].relative_to(ROOT).as_posix()
            assert place.startswith(HOME[library]), place


def reachable(start: str) -> set[str]:
    names, left = set(), [start]
    while left:
        name = left.pop()
        if name not in names:
            names.add(name)
            left += GRAPH.get(name, ())
    return names


@pytest.mark.parametrize("room_name", ["rewards", "agents"])
def test_rewards_and_agents_never_reach_the_simulator(room_name: str) -> None:
    start = [name for name in MODULES if room(name) == room_name]
    libraries = {name.split(".")[0] for s in start for name in reachable(s)}
    assert len(start) > 1
    assert not libraries & {"mujoco", "llvmlite", "robosuite", "tasks"}


def test_there_is_no_cycle() -> None:
    inside = {name: names & MODULES.keys() for name, names in GRAPH.items()}
    order = list(TopologicalSorter(inside).static_order())
    assert len(order) == len(MODULES)
