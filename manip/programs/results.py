"""`manip results`: what the shipped recipes reach."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from manip.errors import UserError
from manip.evaluation.shipped_results import (
    HEADER,
    Result,
    Results,
    load_results,
    markdown,
    rows,
)
from manip.io.atomic_files import write_text
from manip.programs import cli

BEGIN = "<!-- results: written by `manip results --readme README.md` -->\n"
END = "<!-- end of results -->\n"


@dataclass(frozen=True)
class ShowResults:
    """Show what the shipped recipes reach (see `manip reproduce`)."""

    readme: Path | None = None
    """Write the table into this Markdown file, between its two marks."""


def main(arguments: Sequence[str]) -> int:
    """Print the table, or write it."""
    options = cli.parse(ShowResults, arguments, "manip results")
    found = load_results()
    if options.readme:
        text = options.readme.read_text()
        write_text(options.readme, with_table(text, markdown(found)))
    else:
        Console().print(table(found, found.results))
    return 0


def with_table(text: str, table: str) -> str:
    """The text with the table between its marks.

    Raises:
        UserError: there are no marks.
    """
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise UserError(f"no place for results: mark it by {BEGIN!r} and {END!r}")
    return f"{before}{begin}\n{table}\n{end}{after}"


def table(found: Results, results: Iterable[Result]) -> Table:
    """Results for people to read, a line a seed; narrower than Markdown's."""
    shown = Table(box=SIMPLE, title="success held in stock robosuite")
    narrow = HEADER[: HEADER.index("machine")]
    for column in narrow:
        shown.add_column(column)
    for row in rows(found, results):
        shown.add_row(*(cell.replace(", ", "\n") for cell in row[: len(narrow)]))
    return shown
