"""Compile functions with numba: without the GIL, cached on disk between processes.

Nothing needs a build step: a function is compiled at its first call.
"""

import atexit
import os
import shutil
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from manip.errors import UserError, one_line


def _variables() -> str:
    return " ".join(f"{k}={v}" for k, v in os.environ.items() if k.startswith("NUMBA_"))


try:
    import numba
except ValueError as error:  # NUMBA_NUM_THREADS=0
    raise UserError(
        f"numba cannot be imported with {_variables()}: {one_line(error)}"
    ) from error
if numba.config.DISABLE_JIT:
    raise UserError(
        "NUMBA_DISABLE_JIT is set, but the batch engine needs compiled code: unset it"
    )

from numba.core.codegen import JITCodeLibrary  # noqa: E402
from numba.core.compiler import Compiler  # noqa: E402

_HERE = Path(__file__).parent


@cache
def cache_folder() -> Path:
    """Folder of the compiled code: in NUMBA_CACHE_DIR, by default in this package.

    Its name depends on the sources: numba compiles a function again when the function's
    own file changes, but not when another file changes whose functions it calls.
    """
    parent = os.environ.get("NUMBA_CACHE_DIR")
    folder = Path(parent) if parent else _HERE / "__pycache__"
    sources = [path.read_bytes() for path in sorted(_HERE.rglob("*.py"))]
    compiled = b"".join(text for text in sources if b"manip.compiled import" in text)
    return folder / f"native-{sha256(compiled).hexdigest()[:12]}"


def cache_is_writable() -> bool:
    """Whether compiled code can be stored for later processes."""
    try:
        cache_folder().mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=cache_folder()):
            return True
    except OSError:
        return False


_CACHE = cache_is_writable()
if not _CACHE:
    warnings.warn(
        f"compiled code is not cached: {cache_folder()} is not writable. Each process "
        "compiles again (some 10 s); set NUMBA_CACHE_DIR to a writable folder.",
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
    """Compile a function that only compiled functions call.

    Compiling the entry for Python would take as long as compiling the function. To
    call it from Python, as tests do, compile `jit(function.py_func)`.
    """
    return numba.njit(function, no_cpython_wrapper=True, **_OPTIONS)


_REORDERED = {"reassoc", "contract", "nsz", "arcp"}


def fast_jit(function: Callable[..., Any]) -> Callable[..., Any]:
    """As `jit`, but sums may be reordered: for learning, not for simulation.

    Infinities and NaN keep their meaning.
    """
    return _cached(function, fastmath=_REORDERED)


def fast_kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a function that only `fast_jit` functions call."""
    return numba.njit(
        function, no_cpython_wrapper=True, fastmath=_REORDERED, **_OPTIONS
    )


@contextmanager
def fallback_cache(library: str) -> Iterator[None]:
    """Compile another library's functions where numba has no writable cache folder.

    A library that uses numba's cache fails on import if neither its own folder nor
    the home folder is writable. Functions that it defines in this `with` block are
    then cached in a folder that lasts as long as the process.

    Args:
        library: its name; it is not imported here.
    """
    spec = find_spec(library)
    if spec is None or spec.origin is None or _can_cache(spec.origin):
        yield
        return
    warnings.warn(
        f"code that {library} compiles is not cached: neither its folder "
        f"{Path(spec.origin).parent} nor the home folder is writable. Each process "
        "compiles it again (some 10 s); set NUMBA_CACHE_DIR to a writable folder.",
        stacklevel=3,
    )
    with _cache_in(_temporary_folder()):
        yield


def _can_cache(source: str) -> bool:
    """Whether numba finds a place for the compiled functions of a source file."""
    namespace: dict[str, Any] = {}
    exec(compile("def probe(): pass", source, "exec"), namespace)
    try:
        numba.njit(namespace["probe"], cache=True)
    except RuntimeError:  # "no locator available"
        return False
    return True


@cache
def _temporary_folder() -> str:
    folder = tempfile.mkdtemp(prefix="manip-numba-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


@contextmanager
def _cache_in(folder: str) -> Iterator[None]:
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = folder
    try:
        yield
    finally:
        numba.config.CACHE_DIR = before


def _cached(function: Callable[..., Any], **options: Any) -> Callable[..., Any]:
    with _cache_in(str(cache_folder())):
        return numba.njit(
            function,
            cache=_CACHE,
            pipeline_class=_SelfContainedCompiler,
            **options,
            **_OPTIONS,
        )


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
