"""Offsets in observations: once for the way there, once for the last centimetres."""

from typing import Any

from manip.arrays import namespace


def coarse(offset: Any) -> Any:
    """Offsets [m] up to 30 cm, as numbers in [-3, 3]; numpy or torch."""
    return 10.0 * namespace(offset).clip(offset, -0.3, 0.3)


def fine(offset: Any) -> Any:
    """Offsets [m] up to 2 cm, as numbers in [-1, 1]; numpy or torch."""
    return 50.0 * namespace(offset).clip(offset, -0.02, 0.02)
