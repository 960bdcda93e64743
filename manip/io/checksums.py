"""safetensors files with a SHA-256 checksum of themselves.

The header's metadata holds the checksum of the whole file, computed with zeros in the
checksum's place. Every safetensors reader can read these files. The same tensors and
metadata always give the same bytes: `safetensors.save_file` writes metadata in the
random order of a hash table.

Format: https://github.com/huggingface/safetensors#format
"""

import hashlib
import json
import os
from collections.abc import Mapping
from io import BufferedIOBase
from pathlib import Path
from typing import Any, NamedTuple

import torch

from manip.io.atomic_files import replace_file

_ZEROS = "0" * 64
_MARK = b'"checksum":"'
"""The checksum's place in the header: other text there has its quotes escaped."""

_DTYPES = {
    torch.float64: "F64",
    torch.float32: "F32",
    torch.float16: "F16",
    torch.bfloat16: "BF16",
    torch.int64: "I64",
    torch.int32: "I32",
    torch.int16: "I16",
    torch.int8: "I8",
    torch.uint8: "U8",
    torch.bool: "BOOL",
}
"""torch's dtype -> name in the header."""

_ALIGNMENT = 8
"""The header's length is a multiple of this many bytes, so that tensors are aligned."""


class _Checksum(NamedTuple):
    """The checksum stored in a file, the computed one, and the stored one's offset."""

    stored: bytes
    computed: bytes
    offset: int


def save_with_checksum(
    path: Path, tensors: Mapping[str, torch.Tensor], metadata: Mapping[str, str]
) -> None:
    """Write tensors and metadata to one safetensors file, atomically."""
    replace_file(path, lambda temporary: _write(temporary, tensors, metadata))


def verify_checksum(path: Path) -> None:
    """Read a file once and compare its checksum.

    Raises:
        ValueError: it was changed since it was written, or holds no checksum.
    """
    with path.open("rb") as file:
        checksum = _read_checksum(file)
    if checksum.stored != checksum.computed:
        raise ValueError("its checksum is wrong")


def _write(
    path: Path, tensors: Mapping[str, torch.Tensor], metadata: Mapping[str, str]
) -> None:
    ordered = dict(sorted(tensors.items(), key=_largest_items_first))
    header = _header(ordered, {**metadata, "checksum": _ZEROS})
    with path.open("w+b") as file:
        file.write(len(header).to_bytes(8, "little") + header)
        for tensor in ordered.values():
            file.write(_bytes(tensor))
        file.seek(0)
        checksum = _read_checksum(file)
        file.seek(checksum.offset)
        file.write(checksum.computed)


def _largest_items_first(item: tuple[str, torch.Tensor]) -> tuple[int, str]:
    """Sort key that keeps every tensor aligned to the size of its items."""
    name, tensor = item
    return -tensor.element_size(), name


def _header(tensors: Mapping[str, torch.Tensor], metadata: Mapping[str, str]) -> bytes:
    header: dict[str, object] = {"__metadata__": metadata}
    begin = 0
    for name, tensor in tensors.items():
        end = begin + tensor.nbytes
        header[name] = {
            "dtype": _DTYPES[tensor.dtype],
            "shape": list(tensor.shape),
            "data_offsets": [begin, end],
        }
        begin = end
    text = json.dumps(header, sort_keys=True, separators=(",", ":")).encode()
    return text + b" " * (-len(text) % _ALIGNMENT)


def _bytes(tensor: torch.Tensor) -> Any:
    """A tensor's memory, without a copy where it is contiguous."""
    flat = tensor.detach().contiguous().reshape(-1)
    return flat.view(torch.uint8).numpy()


def _read_checksum(file: BufferedIOBase) -> _Checksum:
    length = file.read(8)
    size = int.from_bytes(length, "little")
    if size > os.fstat(file.fileno()).st_size:
        raise ValueError("it is cut off")
    header = file.read(size)
    offset = header.find(_MARK) + len(_MARK)
    if offset < len(_MARK):
        raise ValueError("it holds no checksum")
    blank = header[:offset] + _ZEROS.encode() + header[offset + len(_ZEROS) :]
    digest = hashlib.sha256(length + blank)
    hashlib.file_digest(file, lambda: digest)
    stored = header[offset : offset + len(_ZEROS)]
    return _Checksum(stored, digest.hexdigest().encode(), len(length) + offset)
