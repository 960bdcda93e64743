"""Distinguish code that came with a file, such as a policy card, from installed code.

Modules are located without importing them, level by level: importing a package to look
for a module inside it would already run the package's code.
"""

import pkgutil
import sys
import sysconfig
from collections.abc import Iterable, Iterator
from contextlib import suppress
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path

RUN_FILES = ("", "config.yaml", "policy.safetensors", "policy/policy.safetensors")
"""What is read of a run folder or of a policy's folder; links are followed."""

RUN_SUBFOLDERS = ("policy", "dumps", "checkpoints")
"""Folders of a run: what lies beside them came along with them."""

INSTALLED = ("stdlib", "platstdlib", "purelib", "platlib")
"""sysconfig's names of the folders of installed code."""

TRUSTED = (
    Path(__file__).parent,
    *(Path(sysconfig.get_path(name)) for name in INSTALLED),
)
"""This package, and what is installed for this interpreter."""


def untrusted_folders(folder: Path) -> set[Path]:
    """The folders that came along with a run folder, a policy folder, or a dump."""
    existing = [folder / name for name in RUN_FILES if (folder / name).exists()]
    places = [folder.absolute(), *(path.resolve() for path in existing)]
    folders = {path.parent if path.is_file() else path for path in places}
    runs = {
        path.parent
        for path in folders
        if path.name in RUN_SUBFOLDERS or (path.parent / "config.yaml").is_file()
    }
    return folders | runs


def is_inside(place: str | Path, folders: Iterable[Path]) -> bool:
    """Whether a path, or what it links to, lies in one of the folders."""
    path = Path(place)
    paths = path.absolute(), path.resolve()
    return any(each.is_relative_to(folder) for each in paths for folder in folders)


def is_untrusted(place: str | Path, folders: Iterable[Path]) -> bool:
    """Whether a path lies in one of the folders, and is not installed code."""
    installed = any(Path(place).absolute().is_relative_to(each) for each in TRUSTED)
    return not installed and is_inside(place, folders)


def import_places(module: str) -> Iterator[str]:
    """Files and folders of each package on the way to a dotted module, and its own."""
    parts, path = module.split("."), None
    for depth in range(1, len(parts) + 1):
        spec = _find_spec(".".join(parts[:depth]), path)
        if spec is None:
            return
        if spec.origin:
            yield spec.origin
        if spec.submodule_search_locations is None:
            return
        path = list(spec.submodule_search_locations)
        yield from path


def _find_spec(name: str, path: list[str] | None) -> ModuleSpec | None:
    """As the import system does, but without importing the parent packages."""
    loaded = getattr(sys.modules.get(name), "__spec__", None)
    if isinstance(loaded, ModuleSpec):
        return loaded
    for finder in sys.meta_path:
        spec = None
        if finder is PathFinder:
            spec = _search(name, sys.path if path is None else path)
        else:
            with suppress(Exception):  # some need the parent to be imported
                spec = finder.find_spec(name, path)
        if spec is not None:
            return spec
    return None


def _search(name: str, path: Iterable[str]) -> ModuleSpec | None:
    """PathFinder's search, which needs imported parents for namespace packages."""
    portions: list[str] = []
    for entry in path:
        finder = pkgutil.get_importer(entry or str(Path.cwd()))
        spec = finder.find_spec(name) if finder is not None else None
        if spec is not None and spec.loader is not None:
            return spec
        if spec is not None:
            portions += spec.submodule_search_locations or ()
    if not portions:
        return None
    namespace = ModuleSpec(name, None, is_package=True)
    namespace.submodule_search_locations = portions
    return namespace
