"""The libraries of the extra `data`, imported where they are needed."""

import importlib
from types import ModuleType

from manip.errors import UserError


def library(name: str) -> ModuleType:
    """Import a library of the extra `data`.

    Raises:
        UserError: it is not installed.
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise UserError(
            f"data sets need {error.name}: pip install av h5py minari pyarrow (the "
            "extra `data`)"
        ) from None
