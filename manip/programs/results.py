"""`manip results`: show the results of the shipped recipes."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.box import SIMPLE
from rich.table import Table
from rich.text import Text

from manip.errors import UserError
from manip.evaluation.results_table import HEADER, NOTE, markdown, rows
from manip.evaluation.shipped_results import Result, Results, load_results
from manip.io.atomic_files import write_text
from manip.io.output_paths import check_output
from manip.io.printable import printable
from manip.programs import cli
from manip.programs.output import console

BEGIN = "<!-- results: written by `manip results --readme README.md` -->\n"
END = "<!-- end of results -->\n"


@dataclass(frozen=True)
class ShowResults:
    """Show the success of the shipped recipes in stock robosuite.

    `manip reproduce` trains them again and compares.
    """

    readme: Path | None = None
    """Markdown file to write the table into, between its two marks, instead of
    printing it."""


def main(arguments: Sequence[str]) -> int:
    """Print the table, or write it."""
    options = cli.parse(ShowResults, arguments, "manip results")
    stored = load_results()
    if options.readme:
        check_output(options.readme, "--readme")
        text = options.readme.read_text()
        write_text(options.readme, with_table(text, markdown(stored)))
    else:
        console().print(table(stored, stored.results))
    return 0


def with_table(text: str, table: str) -> str:
    """Replace the text between the two marks by a table.

    Raises:
        UserError: a mark is missing.
    """
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise UserError(
            f"the file has no place for the table: add the lines {BEGIN!r} and {END!r}"
        )
    return f"{before}{begin}\n{table}\n{end}{after}"


def table(stored: Results, results: Iterable[Result]) -> Table:
    """Results as a table without the last two columns of the Markdown table."""
    shown = Table(box=SIMPLE, title="success in stock robosuite", caption=NOTE)
    columns = HEADER[: HEADER.index("machine")]
    for column in columns:
        shown.add_column(column, overflow="fold")
    for row in rows(stored, results):
        shown.add_row(*(Text(printable(cell)) for cell in row[: len(columns)]))
    return shown
