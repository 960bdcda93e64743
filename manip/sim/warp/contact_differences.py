"""How the contacts of MuJoCo Warp differ from those of C."""

from dataclasses import dataclass, field

ROUNDING = 1e-6
"""Depths [m] up to this one may differ, and shallower contacts may be missing."""


@dataclass
class ContactDifferences:
    """Contacts of pairs of geoms of one kind, such as box-box, over many states.

    Attributes:
        native, warp: number of contacts.
        pairs: number of pairs in contact in both.
        missed: depths [m] of the deepest contact of pairs in contact in C only.
        ghosts: the same of pairs in contact on Warp only.
        depth: largest difference [m] of the deepest contacts of a pair in both.
    """

    native: int = 0
    warp: int = 0
    pairs: int = 0
    missed: list[float] = field(default_factory=list)
    ghosts: list[float] = field(default_factory=list)
    depth: float = 0.0

    def add(self, native: list[float], warp: list[float]) -> None:
        """Add a pair by the depths of its contacts."""
        self.native += len(native)
        self.warp += len(warp)
        if native and warp:
            self.pairs += 1
            self.depth = max(self.depth, abs(max(native) - max(warp)))
        elif max([*native, *warp]) > ROUNDING:
            (self.missed if native else self.ghosts).append(max([*native, *warp]))
