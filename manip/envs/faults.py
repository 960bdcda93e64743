"""Numbers that went wrong in a world: which, where, and how to see it again."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

Array = np.ndarray


class Fault(NamedTuple):
    """What was not finite, or no physics any more, in a step of one world.

    what: "physics", "action", "observation 'cube_pos'", "reward term 'reach'", or
    several of them. step: control steps of the episode, with this one.
    """

    task: str
    what: str
    world: int
    episode: int
    step: int

    def __str__(self) -> str:
        return (
            f"{self.task}: {self.what} of world {self.world} is not finite in step "
            f"{self.step} of its episode {self.episode}"
        )

    @property
    def name(self) -> str:
        """Fit for a file."""
        return f"world{self.world}-episode{self.episode}-step{self.step}"


def not_finite(
    kind: str, parts: Mapping[str, Array], worlds: int
) -> list[tuple[str, Array]]:
    """What of the parts, [N] or [N, k] each, is not finite as float32, and where."""
    with np.errstate(over="ignore"):
        finite = {
            f"{kind} {name!r}": np.isfinite(np.asarray(part, np.float32))
            for name, part in parts.items()
        }
    return [
        (name, np.logical_not(found.reshape(worlds, -1).all(axis=1)))
        for name, found in finite.items()
    ]
