"""The language of sources and documents, and the sizes of files and functions."""

import ast
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from statistics import median

import pytest

ROOT = Path(__file__).parents[1]

PRODUCT = ("manip", "tasks", "scripts")
"""Folders of the sources; `manip/tasks` is a link to `tasks`."""

WORDS = (
    # names that were replaced
    *("Worlds", "Moment", "Sight", "Crew", "StateBank", "Rig", "own-starts"),
    *("num-worlds", "contestant", "contestants"),
    # personification, idioms, inversions
    *("worlds", "whoever", "nobody", "everybody", "somebody"),
    *("is told", "are told", "told in a line", "tells of", "tell of"),
    *("not for the asking", "asks the", "at home in", "stands on", "held still"),
)
"""Words and phrases that have a plain term in the field, whole words only."""

NAMES = {
    *("found", "told", "asked", "kept", "said", "mine", "theirs", "seen"),
    *("world", "worlds", "rig", "rigs", "judge", "held", "crew", "bank"),
}
"""Identifiers that do not say what they hold."""

LONGEST_FILE = 300
MOST_ARGUMENTS = 8
MEDIAN_FUNCTION = 7


def sources(*folders: str) -> list[Path]:
    return [
        path for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))
    ]


def documents() -> list[Path]:
    texts = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]
    recipes = (ROOT / "assets").rglob("*.yaml")
    others = [*texts, *recipes, *(ROOT / "docs").rglob("*.py"), ROOT / "Makefile"]
    return [path for path in others if path.name != "CHANGELOG.md"]


def relative(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


TEXTS = {
    path: path.read_text(encoding="utf-8")
    for path in [*sources(*PRODUCT, "tests"), *documents()]
    if path.name != Path(__file__).name
}
TREES = {path: ast.parse(TEXTS[path]) for path in sources(*PRODUCT)}


def pattern(word: str) -> re.Pattern[str]:
    """A whole word; a phrase also where a line break or comment sign is inside."""
    spaced = r"[\s#]+".join(map(re.escape, word.split(" ")))
    return re.compile(rf"(?<![\w-]){spaced}(?![\w-])")


@pytest.mark.parametrize("word", WORDS)
def test_a_word_with_a_plain_term_is_not_used(word: str) -> None:
    wanted = pattern(word)
    places = [
        f"{relative(path)}:{text.count(chr(10), 0, match.start()) + 1}"
        for path, text in TEXTS.items()
        for match in wanted.finditer(text)
    ]
    assert places == []


def identifiers(path: Path) -> Iterator[tuple[str, int]]:
    for node in ast.walk(TREES[path]):
        if isinstance(node, ast.Name):
            yield node.id, node.lineno
        elif isinstance(node, ast.arg):
            yield node.arg, node.lineno
        elif isinstance(node, ast.Attribute):
            yield node.attr.lstrip("_"), node.lineno


def test_identifiers_name_what_they_hold() -> None:
    places = {
        f"{relative(path)}:{line} {name}"
        for path in TREES
        for name, line in identifiers(path)
        if name in NAMES
    }
    assert sorted(places) == []


def functions(path: Path) -> Iterator[ast.FunctionDef]:
    for node in ast.walk(TREES[path]):
        if isinstance(node, ast.FunctionDef):
            yield node


def length(node: ast.FunctionDef) -> int:
    """Lines of a function, from its `def` to its end, without its docstring."""
    start = node.body[0]
    documented = ast.get_docstring(node) is not None
    text = start.end_lineno - start.lineno + 1 if documented else 0
    return node.end_lineno - node.lineno + 1 - text


def test_no_file_is_long() -> None:
    lines = {relative(p): len(TEXTS[p].splitlines()) for p in TREES}
    assert {name: n for name, n in lines.items() if n > LONGEST_FILE} == {}


def test_the_median_function_is_short() -> None:
    lengths = [length(node) for path in TREES for node in functions(path)]
    assert len(lengths) > 500
    assert median(lengths) <= MEDIAN_FUNCTION


def test_constructors_have_few_arguments() -> None:
    """Of classes that write their constructor; dataclasses of options have none."""
    counts = {
        f"{relative(path)}:{node.lineno}": len(
            [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
        )
        - 1
        for path in TREES
        for node in functions(path)
        if node.name == "__init__"
    }
    assert {place: n for place, n in counts.items() if n > MOST_ARGUMENTS} == {}


def public_functions(path: Path) -> Iterator[ast.FunctionDef]:
    """Functions of a module and methods of its public classes, unless private."""
    tree = TREES[path]
    classes = [node for node in tree.body if isinstance(node, ast.ClassDef)]
    bodies = [tree.body, *(c.body for c in classes if not c.name.startswith("_"))]
    for body in bodies:
        for node in body:
            if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
                yield node


def inherits_docstring(node: ast.FunctionDef) -> bool:
    """Whether it is a setter or a variant of an overloaded function."""
    names = [ast.unparse(decorator) for decorator in node.decorator_list]
    return any(name.endswith((".setter", "overload")) for name in names)


def test_every_public_function_has_a_docstring() -> None:
    missing = [
        f"{relative(path)}:{node.lineno} {node.name}"
        for path in TREES
        for node in public_functions(path)
        if not ast.get_docstring(node) and not inherits_docstring(node)
    ]
    assert missing == []


def test_no_basename_occurs_twice() -> None:
    """Editors show basenames. Programs have the names of their commands."""
    rooms = [path.relative_to(ROOT / "manip") for path in sources("manip")]
    names = Counter(
        path.name
        for path in rooms
        if not path.name.startswith("__") and path.parts[0] not in ("programs", "tasks")
    )
    assert {name: n for name, n in names.items() if n > 1} == {}
