"""The help of the programs as Markdown."""

import contextlib
import importlib
import io
import os
import re
from collections.abc import Sequence
from typing import NamedTuple

# Boxes stand side by side from 130 columns on.
os.environ.update(COLUMNS="120", NO_COLOR="1", TERM="dumb")


class Row(NamedTuple):
    """An option or argument as `--help` prints it."""

    name: str
    help: str


class Help(NamedTuple):
    """Usage, description, and title of a box -> its rows."""

    usage: str
    description: str
    boxes: dict[str, list[Row]]


def help_of(program: str, arguments: Sequence[str] = ()) -> Help:
    """Run a program of manip with --help, and read what it prints."""
    main = importlib.import_module(f"manip.programs.{program}").main
    printed = io.BytesIO()
    text = io.TextIOWrapper(printed, encoding="utf-8", write_through=True)
    with contextlib.redirect_stdout(text), contextlib.suppress(SystemExit):
        main([*arguments, "--help"])
    return read(printed.getvalue().decode())


def read(text: str) -> Help:
    """Split the text of --help into its parts."""
    head, *_ = text.partition("╭")
    usage, _, description = head.strip().partition("\n\n")
    boxes: dict[str, list[Row]] = {}
    for line in text.splitlines():
        if line.startswith("╭"):
            rows = boxes.setdefault(line.strip("╭╮─ "), [])
        elif line.startswith("│"):
            _add(line[2:].rstrip("│ "), rows)
    return Help(usage.removeprefix("usage: "), description, boxes)


def _add(line: str, rows: list[Row]) -> None:
    """Add a line of a box: a new row, or the rest of the one before it.

    A rule ends the description of the box, which is left out.
    """
    if line.startswith("─"):
        rows.clear()
    elif line.startswith(" ") and rows:
        name, text = rows[-1]
        rows[-1] = Row(name, f"{text} {line.strip()}".strip())
    elif line:
        name, _, text = line.partition("  ")
        rows.append(Row(name, text.strip()))


def definitions(rows: Sequence[Row]) -> str:
    """Rows as a Markdown definition list, without the row of --help itself."""
    return "\n\n".join(
        f"`{row.name}`\n: {_plain(row.help)}"
        for row in rows
        if not row.name.startswith("-h")
    )


def _plain(text: str) -> str:
    """Escape what Markdown would read as markup outside of code."""
    parts = re.split("(`[^`]*`)", text)
    escaped = [re.sub(r"([*_<>\[\]$])", r"\\\1", part) for part in parts[::2]]
    parts[::2] = escaped
    return "".join(parts)
