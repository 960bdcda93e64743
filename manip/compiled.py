"""numba set-up: native code without the GIL, kept on disk between processes.

Nothing needs a build step: code is compiled when it is first called.
"""

import os
import tempfile
import warnings
from collections.abc import Callable
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import numba
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler

_HERE = Path(__file__).parent


@cache
def cache_folder() -> Path:
    """Folder of the compiled code: in NUMBA_CACHE_DIR, else beside this package.

    Each state of the sources has its own: numba compiles a function anew when its own
    file changes, but not when a file does whose functions it calls.
    """
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    folder = Path(chosen) if chosen else _HERE / "__pycache__"
    sources = [path.read_bytes() for path in sorted(_HERE.rglob("*.py"))]
    compiled = b"".join(text for text in sources if b"manip.compiled import" in text)
    return folder / f"native-{sha256(compiled).hexdigest()[:12]}"


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


_WEAK = {"linkonce_any", "linkonce_odr", "weak_any", "weak_odr"}
"""Linkages of functions that a loader binds to any function of equal name."""


def jit(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile to native code that runs without the GIL, cached where possible."""
    return _cached(function)


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
    return _cached(function, fastmath=_REORDERED)


def fast_kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile as a part of `fast_jit` functions, as `kernel` does for `jit`."""
    return numba.njit(
        function, no_cpython_wrapper=True, fastmath=_REORDERED, **_OPTIONS
    )


def _cached(function: Callable[..., Any], **options: Any) -> Callable[..., Any]:
    others = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(cache_folder())
    try:
        return numba.njit(
            function,
            cache=_CACHE,
            pipeline_class=_SelfContainedCompiler,
            **options,
            **_OPTIONS,
        )
    finally:
        numba.config.CACHE_DIR = others


class _SelfContainedLibrary(JITCodeLibrary):
    """Compiled code that calls its own copies of the kernels that are linked into it.

    numba leaves these copies weak: a call is bound to the first function of that name
    in the process. That is the copy where the code comes from the cache, but the kernel
    as compiled for itself in the process that fills the cache. LLVM optimises the two
    differently, so that reordered sums differ in their last bits. Calls of internal
    functions are bound within the library in every process.
    """

    def _optimize_final_module(self) -> None:
        super()._optimize_final_module()
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage.name in _WEAK:
                function.linkage = "internal"


class _SelfContainedCompiler(Compiler):
    """numba's compiler, writing to a `_SelfContainedLibrary`."""

    def compile_extra(self, func: Callable[..., Any]) -> Any:
        codegen = self.state.targetctx.codegen()
        self.state.library = _SelfContainedLibrary(codegen, func.__qualname__)
        self.state.library.enable_object_caching()
        return super().compile_extra(func)
