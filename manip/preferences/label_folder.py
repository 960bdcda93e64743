"""The comparisons of one run in a folder of preferences.

`queries.jsonl` holds the pairs that runs ask for, `comparisons.jsonl` the answers, and
`rounds.jsonl` how many lines of answers each round of each run has learned from: all
are append-only. A run that is killed and resumed finds its pairs and answers there, and
learns from the same lines again, whatever was appended in the meantime.
"""

from collections.abc import Sequence
from pathlib import Path

from manip.errors import DamagedError, UserError
from manip.io.json_lines import append_lines, read_lines
from manip.preferences.comparison_record import Answer, Comparison
from manip.preferences.comparisons import (
    append_comparison,
    effective,
    read_comparisons,
    valid_comparisons,
)
from manip.preferences.pair_queue import Pair, append_pairs, read_pairs

ROUNDS = "rounds.jsonl"
"""Name of the file that says what each round has used."""


class LabelFolder:
    """Pairs and answers of a run, round by round.

    Args:
        folder: folder of preferences.
        run: identifies the run; others may use the same folder.
    """

    def __init__(self, folder: Path, run: str) -> None:
        self.folder, self._run = folder, run

    def check(self) -> None:
        """Read all files, before a run that needs them.

        Raises:
            UserError: one is no regular file.
            DamagedError: one is damaged.
        """
        read_pairs(self.folder)
        read_comparisons(self.folder)
        read_lines(self.folder / ROUNDS)

    def pairs(self, number: int) -> list[Pair]:
        """The pairs that the run requested in a round."""
        pairs = read_pairs(self.folder)
        return [pair for pair in pairs if (pair.run, pair.round) == (self._run, number)]

    def ask(self, number: int, pairs: Sequence[tuple[str, str]]) -> None:
        """Ask for pairs of clip ids in a round, each at most once."""
        unique = {frozenset(pair): pair for pair in pairs}.values()
        append_pairs(
            self.folder,
            [Pair(number, left, right, self._run) for left, right in unique],
        )

    def unanswered(self, number: int) -> list[Pair]:
        """The pairs of a round without an answer, on either side."""
        answered = {answer.pair for answer in valid_comparisons(self.folder)}
        return [
            pair
            for pair in self.pairs(number)
            if frozenset((pair.left, pair.right)) not in answered
        ]

    def answer(self, pair: Pair, answer: Answer, labeller: str) -> None:
        """Record an answer to a pair."""
        clips = pair.left, pair.right
        append_comparison(self.folder, labeller, clips, answer, number=pair.round)

    def present(self) -> list[Comparison]:
        """All answers, also those that other runs requested."""
        return valid_comparisons(self.folder)

    def count(self) -> int:
        """Number of `present` answers."""
        return len(self.present())

    def answers(self, number: int) -> list[Comparison]:
        """The answers from which a round learns: all, the first time it is called."""
        records = read_comparisons(self.folder)
        lines = self._used(number)
        if lines is None:
            lines = len(records)
            used = {"run": self._run, "round": number, "lines": lines}
            append_lines(self.folder / ROUNDS, [used])
        if lines > len(records):
            raise DamagedError(
                f"{self.folder} is damaged: round {number} has used {lines} "
                f"comparisons, and there are only {len(records)}"
            )
        return effective(records[:lines])

    def check_used(self, rounds: int) -> None:
        """Check that the folder is the one from which earlier rounds have learned.

        Args:
            rounds: number of rounds that the run has learned from.

        Raises:
            UserError: the folder knows nothing of one of them.
        """
        for number in range(rounds):
            if self._used(number) is None:
                raise UserError(
                    f"{self.folder} does not hold the comparisons of round {number}, "
                    "from which the run has learned: name the folder that does with "
                    "--preferences, or start another run"
                )

    def _used(self, number: int) -> int | None:
        for line in read_lines(self.folder / ROUNDS):
            if (line.get("run"), line.get("round")) == (self._run, number):
                lines = line.get("lines")
                if isinstance(lines, int) and lines >= 0:
                    return lines
        return None
