"""What a labeller sees, and what an answer or an undo does to the folder's files."""

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from manip.preferences.agreement import Repeats, agreement
from manip.preferences.comparison_record import Answer, Comparison
from manip.preferences.comparisons import (
    append_comparison,
    undo_last,
    valid_comparisons,
)
from manip.preferences.page.pair_choice import choose_pair, open_pairs
from manip.preferences.pair_queue import Pair, read_pairs

AHEAD = 3
"""Open pairs whose clips a page loads ahead."""

PACE = 20
"""A labeller's pace is the median time of as many answers."""


@dataclass(frozen=True)
class LabelProgress:
    """How far the queue is answered, and how repeatable a labeller's answers are."""

    answered: int
    """Pairs of the queue that have an answer, of anyone."""
    total: int
    """Pairs in the queue."""
    seconds_left: float | None
    """Time [s] to the end of the queue at the labeller's pace; None without answers."""
    own: Repeats
    """How often the labeller repeats an answer of their own."""
    between: Repeats
    """How often two labellers give the same answer."""


@dataclass(frozen=True)
class LabelView:
    """What a labeller's page shows."""

    pair: Pair | None
    """The pair to compare; None when all are answered."""
    ahead: list[str]
    """Clips of the pairs that come next."""
    can_undo: bool
    """Whether the labeller has an answer to take back."""
    progress: LabelProgress


class LabelSession:
    """The pairs of a folder, shared out among labellers.

    A pair is shown to one labeller; a share of those shown are repeated ones. All is
    stored in the folder's files, except for which pair is on whose screen. Methods may
    be called from any thread.

    Args:
        folder: holds clips, pairs and comparisons.
        repeats: share of the pairs shown that are repeated, 0 to 0.5.
    """

    def __init__(self, folder: Path, repeats: float) -> None:
        self._folder = folder
        self._every = round(1 / repeats) if repeats else 0
        self._on_screen: dict[str, Pair] = {}
        self._lock = threading.Lock()

    def view(self, labeller: str) -> LabelView:
        """What the labeller's page shows: the same pair until it is answered."""
        with self._lock:
            return self._view(labeller)

    def answer(
        self, labeller: str, pair: tuple[str, str], answer: Answer, seconds: float
    ) -> LabelView:
        """Store an answer to the pair on the labeller's screen; returns the next view.

        An answer to another pair is ignored: it was answered in another window.

        Args:
            labeller: name of the labeller.
            pair: the clips, left and right.
            answer: left, right, equal or skip.
            seconds: time that the labeller took.

        Raises:
            OSError: the answer cannot be written.
        """
        with self._lock:
            shown = self._view(labeller).pair
            if shown is not None and (shown.left, shown.right) == pair:
                time = round(seconds, 2)
                append_comparison(
                    self._folder, labeller, pair, answer, time, shown.round
                )
                del self._on_screen[labeller]
            return self._view(labeller)

    def undo(self, labeller: str) -> LabelView:
        """Take back the labeller's last answer, and show that pair again."""
        with self._lock:
            undone = undo_last(self._folder, labeller)
            if undone is not None:
                pair = Pair(undone.round, undone.left, undone.right)
                self._on_screen[labeller] = pair
            return self._view(labeller)

    def open_count(self) -> int:
        """Number of pairs that wait for an answer."""
        queue, valid = read_pairs(self._folder), valid_comparisons(self._folder)
        return len(open_pairs(queue, valid))

    def clips_needed(self) -> list[str]:
        """Clips on screens, then those of the open pairs in the queue's order."""
        with self._lock:
            shown = list(self._on_screen.values())
        queue = read_pairs(self._folder)
        return _clips([*shown, *open_pairs(queue, valid_comparisons(self._folder))])

    def _view(self, labeller: str) -> LabelView:
        queue = read_pairs(self._folder)
        valid = valid_comparisons(self._folder)
        pair = self._pair(queue, valid, labeller)
        ahead = open_pairs(queue, valid)[: AHEAD + len(self._on_screen)]
        return LabelView(
            pair=pair,
            ahead=_clips(ahead),
            can_undo=any(each.labeller == labeller for each in valid),
            progress=_progress(queue, valid, labeller),
        )

    def _pair(
        self, queue: Sequence[Pair], valid: Sequence[Comparison], labeller: str
    ) -> Pair | None:
        if labeller not in self._on_screen:
            taken = list(self._on_screen.values())
            pair = choose_pair(queue, valid, labeller, taken, self._every)
            if pair is None:
                return None
            self._on_screen[labeller] = pair
        return self._on_screen[labeller]


def _clips(pairs: Sequence[Pair]) -> list[str]:
    """The clips of the pairs, in order, each once."""
    return list(dict.fromkeys(c for pair in pairs for c in (pair.left, pair.right)))


def _progress(
    queue: Sequence[Pair], valid: Sequence[Comparison], labeller: str
) -> LabelProgress:
    left = len(open_pairs(queue, valid))
    pace = [each.seconds for each in valid if each.labeller == labeller][-PACE:]
    repeats = agreement(valid)
    return LabelProgress(
        answered=len(queue) - left,
        total=len(queue),
        seconds_left=left * median(pace) if pace else None,
        own=repeats.by_labeller.get(labeller, Repeats(0, 0)),
        between=repeats.between,
    )
