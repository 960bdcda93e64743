"""The pairs of clips that wait for an answer, in `queries.jsonl`.

A training run, or `manip label --pairs`, appends pairs. Earlier lines never change.
"""

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from manip.errors import DamagedError
from manip.io.json_lines import append_lines, read_lines

QUEUE = "queries.jsonl"
"""Name of the file in a folder of preferences."""


@dataclass(frozen=True)
class Pair:
    """Two clips that are to be compared."""

    round: int
    """Round of labels, of the run that asks, to which the pair belongs."""
    left: str
    """Id of the clip shown on the left."""
    right: str
    """Id of the clip shown on the right."""
    run: str = ""
    """Which training run asks; empty for pairs that were drawn for no run."""


def read_pairs(folder: Path) -> list[Pair]:
    """Read the queue of a folder of preferences, empty without its file.

    Raises:
        DamagedError: a line is no pair.
    """
    lines = enumerate(read_lines(folder / QUEUE), 1)
    return [_pair(line, f"{folder / QUEUE}, line {i}") for i, line in lines]


def append_pairs(folder: Path, pairs: Iterable[Pair]) -> None:
    """Add pairs at the end of the queue, all or none."""
    folder.mkdir(parents=True, exist_ok=True)
    append_lines(folder / QUEUE, map(asdict, pairs))


def _pair(line: dict[str, Any], place: str) -> Pair:
    types = {"round": int, "left": str, "right": str}
    wrong = [name for name, kind in types.items() if type(line.get(name)) is not kind]
    if wrong or line["left"] == line["right"]:
        raise DamagedError(
            f"{place} is damaged: expected a round (whole number) and the ids of two "
            "different clips, left and right"
        )
    return Pair(line["round"], line["left"], line["right"], str(line.get("run", "")))
