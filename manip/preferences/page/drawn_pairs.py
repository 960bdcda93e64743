"""Draw pairs of clips at random, for labels that no training run waits for."""

from pathlib import Path
from random import Random

from manip.errors import UserError
from manip.preferences.clips import clip_ids
from manip.preferences.pair_queue import Pair, append_pairs, read_pairs


def fill_queue(folder: Path, number: int, seed: int) -> None:
    """Add random pairs of a folder's clips until its queue holds a number of pairs.

    No pair occurs twice. All clips occur before one occurs again.

    Raises:
        UserError: the clips do not make so many pairs.
    """
    queue = read_pairs(folder)
    clips = clip_ids(folder)
    most = len(clips) * (len(clips) - 1) // 2
    if number > max(most, len(queue)):
        raise UserError(
            f"{folder} has {len(clips)} clips, which make {most} pairs, and {number} "
            "are requested: store more clips, or ask for fewer pairs"
        )
    used = {pair.clips for pair in queue}
    append_pairs(folder, _draw(clips, number - len(queue), used, Random(seed)))


def _draw(
    clips: list[str], count: int, used: set[frozenset[str]], random: Random
) -> list[Pair]:
    pairs: list[Pair] = []
    while len(pairs) < count:
        order = random.sample(clips, len(clips))
        for left, right in zip(order[::2], order[1::2], strict=False):
            pair = Pair(0, left, right)
            if len(pairs) < count and pair.clips not in used:
                used.add(pair.clips)
                pairs.append(pair)
    return pairs
