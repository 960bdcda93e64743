"""The libraries that manip is measured against: an optional extra."""

import importlib
from types import ModuleType

from manip.errors import UserError

INSTALL = "make peers"
"""What installs them. pip's own `manip[peers]` cannot: robosuite declares packages that
contradict the tested versions (see requirements.lock)."""


def peer(module: str) -> ModuleType:
    """A module of this package that needs the extra `peers`.

    Raises:
        UserError: the extra is not installed.
    """
    try:
        return importlib.import_module(f"manip.benchmarks.{module}")
    except ModuleNotFoundError as error:
        raise UserError(
            f"{error.name} is not installed: `{INSTALL}` installs the libraries that "
            "this benchmark compares with"
        ) from error
