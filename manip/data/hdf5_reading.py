"""Read arrays of HDF5 files of any origin: as data alone, and not more than fits."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from manip.data.extra_libraries import library
from manip.errors import DamagedError, UserError, one_line, shown

Array = np.ndarray

MOST_BYTES = 2**33
"""Most bytes of arrays that are read from one file, after decompression."""

MOST_EPISODES = 100_000


@contextmanager
def open_hdf5(path: Path) -> Iterator["SafeFile"]:
    """An HDF5 file to read.

    Raises:
        UserError: there is no such file, h5py is missing.
        DamagedError: it is of another kind, or reading it failed.
    """
    h5py = library("h5py")
    if not path.is_file():
        raise UserError(f"there is no file {path}")
    try:
        with h5py.File(path, "r") as file:
            yield SafeFile(file, h5py)
    except UserError as error:
        raise DamagedError(f"{path}: {error}") from error
    except Exception as error:  # a file can hold anything
        reason = one_line(error)
        raise DamagedError(f"{path} is damaged or no HDF5 file: {reason}") from error


class SafeFile:
    """The arrays and attributes of an open file, by their names.

    Links to other files and arrays that lie in other files are refused.
    """

    def __init__(self, file: Any, h5py: Any) -> None:
        self._file, self._h5py, self._left = file, h5py, MOST_BYTES

    def names(self, group: str) -> list[str]:
        """Names in a group; none if there is no such group."""
        node = self._node(group)
        return [] if node is None else list(node.keys())

    def text(self, group: str, name: str) -> str:
        """A text attribute; "" if there is none.

        Raises:
            UserError: it is no text.
        """
        node = self._node(group)
        value = "" if node is None else node.attrs.get(name, "")
        if isinstance(value, bytes):
            value = value.decode("utf-8", "replace")
        if not isinstance(value, str):
            raise UserError(f"{name} of {group} is no text")
        return value

    def array(self, name: str, ndim: int) -> Array | None:
        """An array of numbers or flags; None if there is none.

        Raises:
            UserError: it is of another kind, has other axes, or is too large.
        """
        node = self._node(name)
        if node is None:
            return None
        if not isinstance(node, self._h5py.Dataset) or node.dtype.kind not in "biuf":
            raise UserError(f"{name} is no array of numbers")
        if node.is_virtual or node.external:
            raise UserError(f"{name} lies in another file, which is not read")
        if len(node.shape) != ndim:
            raise UserError(f"{name} has shape {node.shape}, not {ndim} axes")
        self._left -= node.size * node.dtype.itemsize
        if self._left < 0:
            raise UserError(f"its arrays are larger than {MOST_BYTES} bytes")
        values: Array = node[()]
        return values

    def required(self, name: str, ndim: int) -> Array:
        """As `array`.

        Raises:
            UserError: there is none, too.
        """
        values = self.array(name, ndim)
        if values is None:
            raise UserError(f"it lacks {name}")
        return values

    def _node(self, name: str) -> Any:
        """A group or array, each step of whose path lies in this file."""
        node = self._file
        for part in filter(None, name.split("/")):
            link = node.get(part, getlink=True) if hasattr(node, "keys") else None
            if link is None:
                return None
            if not isinstance(link, self._h5py.HardLink):
                raise UserError(f"{shown(name)} is a link, which is not followed")
            node = node[part]
        return node
