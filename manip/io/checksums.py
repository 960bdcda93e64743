"""safetensors files that carry a checksum of themselves.

The header's metadata holds the SHA-256 of the whole file, computed with zeros in its
place. Whatever else reads safetensors reads these files, too.
"""

import hashlib
import os
from collections.abc import Mapping
from io import BufferedIOBase
from pathlib import Path
from typing import NamedTuple

import torch
from safetensors import SafetensorError
from safetensors.torch import save_file

from manip.io.atomic_files import replace_file

_OPEN = "0" * 64
_MARK = b'"checksum":"'
"""In the header only, as other text there has its quotes escaped."""


class _Seal(NamedTuple):
    """The checksum that a file holds and the one that it should hold; its place."""

    found: bytes
    true: bytes
    at: int


def save_sealed(
    path: Path, tensors: dict[str, torch.Tensor], metadata: Mapping[str, str]
) -> None:
    """Write tensors and metadata to one file, whole or not at all."""

    def write(to: Path) -> None:
        try:
            save_file(tensors, to, {**metadata, "checksum": _OPEN})
        except SafetensorError as error:
            raise OSError(f"cannot write {path}: {error}") from error
        with to.open("r+b") as file:
            seal = _seal(file)
            file.seek(seal.at)
            file.write(seal.true)

    replace_file(path, write)


def check_seal(path: Path) -> None:
    """Read a file once and compare.

    Raises:
        ValueError: it was changed since it was written, or was never sealed.
    """
    with path.open("rb") as file:
        seal = _seal(file)
    if seal.found != seal.true:
        raise ValueError("its checksum is wrong")


def _seal(file: BufferedIOBase) -> _Seal:
    length = file.read(8)
    size = int.from_bytes(length, "little")
    if size > os.fstat(file.fileno()).st_size:
        raise ValueError("it is cut off")
    header = file.read(size)
    at = header.find(_MARK) + len(_MARK)
    if at < len(_MARK):
        raise ValueError("it holds no checksum")
    blank = header[:at] + _OPEN.encode() + header[at + len(_OPEN) :]
    digest = hashlib.sha256(length + blank)
    hashlib.file_digest(file, lambda: digest)
    found = header[at : at + len(_OPEN)]
    return _Seal(found, digest.hexdigest().encode(), len(length) + at)
