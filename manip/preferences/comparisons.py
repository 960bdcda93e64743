"""The file of comparisons: append-only, one form for people and simulated labellers.

Every line holds a hash of the line before, so that a changed, removed or inserted line
is noticed. A line is on the disk before the next pair is shown. Undo is a line, too.
"""

import json
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, replace
from datetime import UTC, datetime
from pathlib import Path
from shutil import copyfile

from manip.errors import DamagedError, UserError, one_line
from manip.io.atomic_files import replace_file
from manip.io.json_lines import parse_line, raw_lines, update_lines
from manip.preferences.clips import clip_path, load_clip
from manip.preferences.comparison_record import (
    Answer,
    Comparison,
    check_answer,
    comparison_id,
    line_hash,
    read_comparison,
)

COMPARISONS = "comparisons.jsonl"
"""Name of the file in a folder of preferences."""


def read_comparisons(folder: Path) -> list[Comparison]:
    """All lines of a folder's comparisons, those that were undone included.

    An incomplete last line, which a killed program may leave, is ignored with a
    warning: its answer was not confirmed.

    Raises:
        DamagedError: a line is damaged, or the chain of hashes is broken at it.
    """
    path = folder / COMPARISONS
    lines, torn = raw_lines(path)
    if torn:
        warnings.warn(
            f"{path}: line {len(lines) + 1} is incomplete and was ignored", stacklevel=2
        )
    return _parsed(lines, path)


def valid_comparisons(folder: Path) -> list[Comparison]:
    """The answers of a folder that were not undone, in order.

    Raises:
        DamagedError: see `read_comparisons`.
    """
    return effective(read_comparisons(folder))


def effective(records: Sequence[Comparison]) -> list[Comparison]:
    """The answers among the first lines of a file that no line of them undoes."""
    undone = {record.undoes for record in records}
    return [r for r in records if r.undoes is None and r.id not in undone]


def append_comparison(
    folder: Path,
    labeller: str,
    clips: tuple[str, str],
    answer: Answer,
    seconds: float = 0.0,
    number: int = 0,
) -> Comparison:
    """Append an answer; it is on the disk when this returns.

    Args:
        folder: of preferences.
        labeller: who answers.
        clips: ids of the left and the right clip.
        answer: see `Answer`.
        seconds: how long the labeller took.
        number: round of labels that requested it.

    Raises:
        UserError: a name or id is impossible.
    """
    check_answer(labeller, *clips, answer)
    left, right = clips
    values = _stamped(labeller, left, right, answer, float(seconds), number)
    return _append(folder, lambda _: [values])[0]


def undo_last(folder: Path, labeller: str) -> Comparison | None:
    """Append a line that takes back the last valid answer of a labeller.

    Returns:
        The answer that was taken back; None if the labeller has none.

    Raises:
        DamagedError: see `read_comparisons`.
    """
    undone: list[Comparison] = []

    def make(lines: list[bytes]) -> list[Comparison]:
        valid = effective(_parsed(lines, folder / COMPARISONS))
        undone.extend([r for r in valid if r.labeller == labeller][-1:])
        return [
            _stamped(labeller, r.left, r.right, r.answer, 0.0, r.round, undoes=r.id)
            for r in undone
        ]

    _append(folder, make)
    return undone[0] if undone else None


def merge_comparisons(folder: Path, other: Path) -> int:
    """Append the comparisons of another folder that this one lacks, and their clips.

    Returns:
        The number of lines that were appended.

    Raises:
        DamagedError: a line or a clip of the other folder is damaged.
        UserError: the other folder lacks one of its clips, or holds no comparisons.
    """
    given = read_comparisons(other)
    if not given:
        raise UserError(f"{other} holds no comparisons (no {COMPARISONS})")
    for clip_id in sorted({clip for record in given for clip in record.pair}):
        _copy_clip(folder, other, clip_id)

    def make(lines: list[bytes]) -> list[Comparison]:
        present = {record.id for record in _parsed(lines, folder / COMPARISONS)}
        return [record for record in given if record.id not in present]

    return len(_append(folder, make))


def _copy_clip(folder: Path, other: Path, clip_id: str) -> None:
    target = clip_path(folder, clip_id)
    if not target.exists():
        load_clip(other, clip_id)  # which checks it
        source = clip_path(other, clip_id)
        replace_file(target, lambda temporary: copyfile(source, temporary))


def _stamped(
    labeller: str,
    left: str,
    right: str,
    answer: Answer,
    seconds: float,
    number: int,
    undoes: str | None = None,
) -> Comparison:
    """A comparison of this moment, not yet in any file."""
    now = datetime.now(UTC).isoformat(timespec="microseconds")
    record = Comparison(
        *("", "", now, labeller, left, right, answer, seconds, number, undoes)
    )
    return replace(record, id=comparison_id(asdict(record)))


def _append(
    folder: Path, make: Callable[[list[bytes]], Iterable[Comparison]]
) -> list[Comparison]:
    """Append the comparisons that `make` returns for the lines that are there."""
    path, added = folder / COMPARISONS, list[Comparison]()

    def chained(lines: list[bytes]) -> Iterable[dict[str, object]]:
        last = lines[-1] if lines else None
        for record in make(lines):
            previous = "" if last is None else line_hash(last)
            values = asdict(replace(record, previous=previous))
            added.append(Comparison(**values))
            last = json.dumps(values).encode()
            yield values

    folder.mkdir(parents=True, exist_ok=True)
    update_lines(path, chained)
    return added


def _parsed(lines: Sequence[bytes], path: Path) -> list[Comparison]:
    """The comparisons of all lines, each checked.

    Raises:
        DamagedError: one is damaged, or the chain of hashes is broken at it.
    """
    records: dict[str, Comparison] = {}
    previous = ""
    for number, line in enumerate(lines, 1):
        try:
            record = read_comparison(parse_line(line, path, number))
            _check_place(record, records, previous)
        except UserError as error:
            raise DamagedError(
                f"{path}: line {number} is damaged: {one_line(error)}"
            ) from error
        records[record.id], previous = record, line_hash(line)
    return list(records.values())


def _check_place(
    record: Comparison, before: dict[str, Comparison], previous: str
) -> None:
    """Raise `UserError` unless a line can follow the lines before."""
    if record.previous != previous:
        raise UserError("it does not follow the line before, or that was changed")
    if record.id in before:
        raise UserError("it repeats an earlier line")
    if record.undoes is None:
        return
    undone = before.get(record.undoes)
    if undone is None or undone.undoes or undone.labeller != record.labeller:
        raise UserError("it undoes no earlier answer of its labeller")
