"""Looks: what varies in images from episode to episode.

A look changes images only: colours, textures of the surroundings, lights, and poses
of cameras (domain randomisation: Tobin et al., 2017). Training draws a new look in
every episode; fixed looks that training never draws test what was learned.
"""

from dataclasses import dataclass
from numbers import Real

from manip.errors import UserError, shown, unknown

GROUPS = ("colours", "textures", "lights", "cameras")
"""What varies."""

UNSEEN = (1, 2, 3)
"""Numbers of the fixed looks of each suite."""

_SUITES = {
    "unseen-textures": ("colours", "textures"),
    "unseen-lights": ("lights",),
    "unseen-cameras": ("cameras",),
    "unseen": GROUPS,
}
"""Suite -> what its looks change."""

SUITES = tuple(
    name for suite in _SUITES for name in (suite, *(f"{suite}-{n}" for n in UNSEEN))
)
"""Names of the suites of three looks, and of each look alone."""


@dataclass(frozen=True)
class Looks:
    """What varies, and how.

    Attributes:
        groups: what varies, of `GROUPS`.
        strength: from 0 to 1, the largest share of the ranges of random changes that an
            episode's look uses.
        unseen: numbers of the fixed looks that episodes take in turn; empty where each
            episode draws its own.
    """

    groups: tuple[str, ...] = ()
    strength: float = 0.0
    unseen: tuple[int, ...] = ()


def check_looks(value: object) -> Looks:
    """The looks of a strength from 0 to 1, or of a suite in `SUITES`, or given ones.

    Raises:
        UserError: it is neither.
    """
    if isinstance(value, Looks):
        return value
    if isinstance(value, str):
        if value not in SUITES:
            raise unknown("looks suite", value, SUITES)
        suite, _, number = value.rpartition("-")
        if number.isdigit():
            return Looks(_SUITES[suite], 1.0, (int(number),))
        return Looks(_SUITES[value], 1.0, UNSEEN)
    number_given = isinstance(value, Real) and not isinstance(value, bool)
    if not number_given or not 0 <= float(value) <= 1:  # type: ignore[arg-type]
        raise UserError(
            "looks must be a strength from 0 to 1 or the name of a suite "
            f"({', '.join(_SUITES)}), not {shown(value)}"
        )
    strength = float(value)  # type: ignore[arg-type]
    return Looks(GROUPS, strength) if strength else Looks()
