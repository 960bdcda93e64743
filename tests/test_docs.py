"""The documents: links lead somewhere, code blocks name what exists."""

import importlib.util
import re
import shlex
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from manip.envs import waypoint_states
from manip.programs.main import PROGRAMS
from manip.sim.scene import Scene

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


HELP = """\
usage: manip x [-h] FILE

What it does.

╭─ options ─────────────────────╮
│ -h, --help      show this     │
│ --length FLOAT                │
│                 Long          │
│                 text.         │
╰───────────────────────────────╯
╭─ more options ────────────────╮
│ Of a kind.                    │
│ ───────────────────────────── │
│ --more.a INT    A.            │
╰───────────────────────────────╯
"""


def name(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


def blocks(page: Path, language: str) -> list[str]:
    text = page.read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


def prose(page: Path) -> str:
    """The text of a page without its blocks and spans of code."""
    text = page.read_text(encoding="utf-8")
    text = re.sub("^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    return re.sub("`[^`]*`", "", text)


def commands() -> list[Any]:
    lines = [
        (page, line)
        for page in PAGES
        for block in blocks(page, "(?:sh|bash|console)")
        for line in block.replace("\\\n", " ").splitlines()
    ]
    return [
        pytest.param(line, id=f"{name(page)}: {line[:60]}")
        for page, line in lines
        if line.startswith("manip ")
    ]


def anchors(page: Path) -> set[str]:
    """Anchors of a page's headings, as GitHub writes them."""
    text = page.read_text(encoding="utf-8")
    text = re.sub("^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    headings = re.findall("^#+ (.*)$", text, re.MULTILINE)
    return {
        re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
        for heading in headings
    }


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_links_lead_to_files_and_headings(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", prose(page)):
        if re.match("https?:|generated/", target):
            continue
        file, _, anchor = target.partition("#")
        linked = (page.parent / file).resolve() if file else page
        assert linked.exists(), target
        assert not anchor or anchor in anchors(linked), target


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_python_blocks_are_python(page: Path) -> None:
    for block in blocks(page, "python"):
        compile(block, page.name, "exec")


def test_the_example_of_a_waypoint_gives_states(
    lift_scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    (block,) = blocks(ROOT / "docs" / "waypoints.md", "python")
    exec(block, scope := {})
    monkeypatch.setattr(waypoint_states, "CANDIDATES", 16)
    maker = waypoint_states.WaypointMaker(scope["GraspedLift"](), lift_scene, 0, 1)
    snapshot, counts = maker.make("grasp", 8)
    assert len(snapshot.states) == 8
    assert counts.valid >= 0.8 * counts.tried


@cache
def _help_pages() -> Any:
    path = ROOT / "docs" / "help_pages.py"
    spec = importlib.util.spec_from_file_location("help_pages", path)
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@cache
def options_of(program: str, *arguments: str) -> set[str]:
    """The options that --help lists."""
    boxes = _help_pages().help_of(program, arguments).boxes
    names = " ".join(row.name for rows in boxes.values() for row in rows)
    return set(re.findall(r"--[a-z][\w.-]*\w", names))


@pytest.mark.parametrize("line", commands())
def test_commands_exist(line: str) -> None:
    _, program, *arguments = shlex.split(line, comments=True)
    assert program in PROGRAMS
    given = {a.split("=")[0] for a in arguments if re.match("--[a-z]", a)}
    assert given <= _known_options(program, arguments) | {"--help"}


def _known_options(program: str, arguments: list[str]) -> set[str]:
    if program == "benchmark" and arguments[:1] == ["task"]:
        return options_of(program, "task")
    known = options_of(program)
    if program == "sweep":
        known = known | options_of("train")
    if program == "train" and "--algo" in arguments:
        algorithm = arguments[arguments.index("--algo") + 1]
        if ":" not in algorithm:  # one of the package's own
            known = known | options_of(program, "--algo", algorithm)
    return known


def test_help_page_has_every_option_once() -> None:
    page = _help_pages().read(HELP)
    assert (page.usage, page.description) == ("manip x [-h] FILE", "What it does.")
    assert page.boxes["options"][1:] == [("--length FLOAT", "Long text.")]
    assert page.boxes["more options"] == [("--more.a INT", "A.")]
