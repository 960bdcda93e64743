"""The pairs of clips that wait for an answer, in `queries.jsonl`.

A training run, or `manip label --pairs`, appends pairs. Earlier lines never change.
"""

from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from manip.errors import DamagedError
from manip.io.json_lines import append_lines, read_lines
from manip.preferences.clips import ID

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

    @property
    def clips(self) -> frozenset[str]:
        """The two clips, whichever is on the left."""
        return frozenset((self.left, self.right))


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
    number, left, right, run = (line.get(f.name, f.default) for f in fields(Pair))
    ids = all(isinstance(clip, str) and ID.fullmatch(clip) for clip in (left, right))
    if not ids or left == right or type(number) is not int or type(run) is not str:
        raise DamagedError(
            f"{place} is damaged: expected a round (whole number) and the ids of two "
            "different clips, left and right"
        )
    return Pair(number, left, right, run)
