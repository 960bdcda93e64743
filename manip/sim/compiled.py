"""numba set-up: libmujoco's C functions as callees, and a cache that may be missing.

Calling the C symbols directly needs no struct offsets and no build step; the object
code is cached on disk between processes.
"""

import os
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import llvmlite.binding
import mujoco
import numba
from numba import types

_LIBRARY = next(Path(mujoco.__file__).parent.glob("libmujoco*"), None)
if _LIBRARY is None:
    raise ImportError(f"no libmujoco beside {mujoco.__file__}: reinstall mujoco")
llvmlite.binding.load_library_permanently(str(_LIBRARY))


def _function(name: str, *arguments: Any) -> types.ExternalFunction:
    return types.ExternalFunction(name, types.void(*arguments))


_pointer, _int = types.intp, types.int32
mj_step1 = _function("mj_step1", _pointer, _pointer)
mj_step2 = _function("mj_step2", _pointer, _pointer)
mj_forward = _function("mj_forward", _pointer, _pointer)
mj_jac_site = _function("mj_jacSite", _pointer, _pointer, _pointer, _pointer, _int)
mju_copy = _function("mju_copy", _pointer, _pointer, _int)


def cache_folder() -> Path:
    """Folder that holds compiled code: NUMBA_CACHE_DIR, else beside this package."""
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    return Path(chosen) if chosen else Path(__file__).parent / "__pycache__"


def cache_is_writable() -> bool:
    """Whether compiled code can be kept between processes."""
    try:
        cache_folder().mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=cache_folder()):
            return True
    except OSError:
        return False


_CACHE = cache_is_writable()
if not _CACHE:
    warnings.warn(
        f"compiled code cannot be kept: {cache_folder()} is not writable. Every start "
        "compiles anew (some 20 s); set NUMBA_CACHE_DIR to a writable folder.",
        stacklevel=2,
    )


def jit(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile to native code that runs without the GIL, cached where possible."""
    return numba.njit(nogil=True, cache=_CACHE)(function)


__all__ = [
    "cache_folder",
    "cache_is_writable",
    "jit",
    "mj_forward",
    "mj_jac_site",
    "mj_step1",
    "mj_step2",
    "mju_copy",
]
