"""No check of manip is an assert statement, which `python -O` removes."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCES = [
    path
    for room in ("manip", "scripts", "tasks")
    for path in (ROOT / room).rglob("*.py")
]


def assertions(source: str) -> Iterator[str]:
    """Assert statements that check something, in code and in code inside strings.

    `assert isinstance(...)` and `assert ... is not None` without a message tell the
    type checker what is known; the next line fails without them, too.
    """
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Assert) and not _narrows_a_type(node):
            yield ast.unparse(node)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield from re.findall(r"^[ ]*assert .+", node.value, re.MULTILINE)


def _narrows_a_type(node: ast.Assert) -> bool:
    test = ast.unparse(node.test)
    narrows = test.startswith("isinstance(") or test.endswith(" is not None")
    return narrows and node.msg is None


@pytest.mark.parametrize(
    ("source", "count"),
    [
        ("assert x > 0", 1),
        ("assert isinstance(x, int)", 0),
        ("assert x is not None", 0),
        ("assert x is not None, 'missing'", 1),
        ("CODE = '''\nimport x\nassert x.fits()\n'''", 1),
    ],
)
def test_assertions_are_detected(source: str, count: int) -> None:
    assert len(list(assertions(source))) == count


def test_nothing_is_checked_by_assert() -> None:
    assertions_of = {
        str(path.relative_to(ROOT)): lines
        for path in SOURCES
        if (lines := list(assertions(path.read_text())))
    }
    assert assertions_of == {}
