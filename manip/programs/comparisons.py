"""`manip comparisons`: check and summarise the comparisons of clips, and merge them."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.table import Table
from rich.text import Text

from manip.errors import UserError
from manip.io.printable import printable
from manip.preferences.agreement import Repeats, agreement
from manip.preferences.clips import load_clip
from manip.preferences.comparison_record import ANSWERS, Comparison
from manip.preferences.comparisons import (
    effective,
    merge_comparisons,
    read_comparisons,
)
from manip.programs import cli
from manip.programs.output import console


@dataclass(frozen=True)
class Comparisons:
    """Check the comparisons of clips in a folder of preferences, and summarise them.

    Every line is checked (each holds a hash of the line before), and every clip that it
    names. The table gives the answers of each labeller, and how often a pair that was
    answered again got the same answer, with its Wilson 95 % interval.
    """

    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]
    """Folder of preferences."""
    merge: tuple[Path, ...] = ()
    """Other folders, such as those of other people: their comparisons that this folder
    lacks are appended, and their clips copied, before the summary."""


def main(arguments: Sequence[str]) -> int:
    """Merge, check, print the table."""
    options = cli.parse(Comparisons, arguments, "manip comparisons")
    if not options.folder.is_dir():
        raise UserError(f"there is no folder {options.folder}")
    for other in options.merge:
        added = merge_comparisons(options.folder, other)
        print(printable(f"{added} lines appended from {other}"))
    records = read_comparisons(options.folder)
    for clip_id in sorted({clip for record in records for clip in record.pair}):
        load_clip(options.folder, clip_id)
    console().print(_table(records))
    return 0


def _table(records: Sequence[Comparison]) -> Table:
    """A row for each labeller, and one for all."""
    answers = effective(records)
    agreed = agreement(answers)
    columns = "labeller", *ANSWERS, "undone", "same when repeated", "95 % interval"
    table = Table(*columns)
    names = sorted({record.labeller for record in records})
    for name in names:
        own = [record for record in records if record.labeller == name]
        table.add_row(*_row(name, own, agreed.by_labeller.get(name)))
    table.add_row(*_row("all", records, agreed.within))
    table.add_row(*_row("between labellers", [], agreed.between))
    return table


def _row(
    name: str, records: Sequence[Comparison], repeats: Repeats | None
) -> list[Text]:
    counts = Counter(record.answer for record in effective(records))
    undone = sum(record.undoes is not None for record in records)
    numbers = [str(counts[answer]) for answer in ANSWERS] + [str(undone)]
    cells = numbers if records else [""] * len(numbers)
    return [Text(printable(cell)) for cell in (name, *cells, *_same(repeats))]


def _same(repeats: Repeats | None) -> tuple[str, str]:
    if repeats is None or repeats.rate is None:
        return "none repeated", ""
    rate = repeats.rate
    share = f"{repeats.same} of {repeats.total}, {rate.rate:.0%}"
    return share, f"{rate.low:.0%} - {rate.high:.0%}"
