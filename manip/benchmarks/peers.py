"""Import the modules that need the optional libraries of `make peers`."""

import importlib
from types import ModuleType

from manip.errors import UserError

INSTALL = "make peers"
"""The command that installs them. `pip install manip[peers]` cannot, because robosuite
declares packages that contradict the tested versions (see requirements.lock)."""


def import_peer(module: str) -> ModuleType:
    """Import a module of this package that needs an optional library.

    Raises:
        UserError: the library is not installed.
    """
    try:
        return importlib.import_module(f"manip.benchmarks.{module}")
    except ModuleNotFoundError as error:
        raise UserError(
            f"{error.name} is not installed: `{INSTALL}` installs the libraries that "
            "this benchmark compares with"
        ) from error
