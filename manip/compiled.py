"""numba set-up: native code without the GIL, kept on disk between processes.

Nothing needs a build step: code is compiled when it is first called.
"""

import os
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba


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
        "compiles anew (some 10 s); set NUMBA_CACHE_DIR to a writable folder.",
        stacklevel=2,
    )


_OPTIONS: dict[str, Any] = {
    "nogil": True,
    "error_model": "numpy",  # x / 0 is inf or nan, without a branch to raise from
    "no_cfunc_wrapper": True,
}


def jit(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile to native code that runs without the GIL, cached where possible."""
    return numba.njit(function, cache=_CACHE, **_OPTIONS)


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile as a part of `jit` functions, which Python itself cannot call.

    Unpacking arguments that come from Python takes as long to compile as the
    function; `jit(kernel.py_func)` can be called.
    """
    return numba.njit(function, no_cpython_wrapper=True, **_OPTIONS)


_REORDERED = {"reassoc", "contract", "nsz", "arcp"}


def fast_jit(function: Callable[..., Any]) -> Callable[..., Any]:
    """As `jit`, free to reorder sums: for learning, where no bit is to be matched.

    Infinities and NaN keep their meaning.
    """
    return numba.njit(function, cache=_CACHE, fastmath=_REORDERED, **_OPTIONS)


def fast_kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile as a part of `fast_jit` functions, as `kernel` does for `jit`."""
    return numba.njit(
        function, no_cpython_wrapper=True, fastmath=_REORDERED, **_OPTIONS
    )
