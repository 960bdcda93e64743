"""A file that would tell if it were unpickled."""

import pickle
from io import BytesIO
from pathlib import Path
from typing import Any

import torch


class Bomb:
    """Leaves a mark where it is unpickled."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.mark,)


def bare(bomb: Bomb) -> bytes:
    """The bomb as Python pickles it."""
    return pickle.dumps(bomb)


def archived(bomb: Bomb) -> bytes:
    """The bomb as torch saves it."""
    buffer = BytesIO()
    torch.save(bomb, buffer)
    return buffer.getvalue()
