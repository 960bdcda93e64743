"""A run's folder: whose files it holds, and that none of them leads out of it."""

import os
from collections.abc import Iterator
from pathlib import Path

from manip.errors import UserError
from manip.io.atomic_files import is_partial, remove_partial, write_text
from manip.io.output_paths import check_output_folder
from manip.io.yaml_files import dump_yaml
from manip.training.checkpoint import Checkpoints
from manip.training.config import TrainConfig, lasting, recorded, to_dict
from manip.versions import versions

FOLDERS = ("checkpoints", "tensorboard", "policy", "dumps")
"""Subfolders that a run writes to."""

FILES = (
    *("run.lock", "config.yaml", "metrics.csv", "learning_curve.png"),
    *(f"checkpoints/{name}.safetensors" for name in ("latest", "previous", "best")),
    *("policy/policy.safetensors", "policy/policy.json"),
)
"""Files that a run writes."""

_BEFORE_TRAINING = {"run.lock", "config.yaml", "checkpoints"}
"""What a run may have written before its first checkpoint."""


def run_folders(folder: Path) -> list[Path]:
    """The folder itself if it holds a run; else the runs of a folder of these.

    Such folders are written by `manip train --seeds` and `manip sweep`.
    """
    if (folder / "config.yaml").is_file():
        return [folder]
    paths = [*folder.glob("*/config.yaml"), *folder.glob("runs/*/config.yaml")]
    return sorted(path.parent for path in paths)


def check_run_folder(config: TrainConfig) -> None:
    """Check that a run may write to its folder, before any work.

    Raises:
        UserError: the folder holds links, devices, another run or other files; it
            holds no run that could be resumed; it cannot be written.
    """
    folder = config.folder
    for place in (folder, *(folder / name for name in FOLDERS)):
        check_output_folder(place, "--out")
    check_entries(folder)
    exists = Checkpoints(folder).exist()
    if config.resume:
        if not exists:
            raise UserError(f"nothing to resume: there is no checkpoint in {folder}")
        return
    if exists:
        raise UserError(
            f"{folder} already holds a run: continue it with --resume, or choose "
            "another folder with --out"
        )
    if not is_startable(config):
        raise UserError(
            f"{folder} is not empty, and holds no run that can be resumed (it holds "
            f"{', '.join(_names(folder))}): choose another folder with --out"
        )


def check_run_options(config: TrainConfig) -> None:
    """Check that a run that exists in the folder has the options of this run.

    Raises:
        UserError: it has others, or its record is damaged.
    """
    if not Checkpoints(config.folder).exist():
        return
    if lasting(recorded(config.folder)) != lasting(config):
        raise UserError(
            f"{config.folder} holds a run with other options: remove it, or choose "
            "another folder with --out"
        )


def is_startable(config: TrainConfig) -> bool:
    """Whether a run's folder is new, empty, or holds the beginning of the same run."""
    folder = config.folder
    entries = [*folder.iterdir()] if folder.exists() else []
    started = all(p.name in _BEFORE_TRAINING or is_partial(p) for p in entries)
    return started and _is_ours(folder / "run.lock") and _is_same_run(config)


def _is_ours(lock: Path) -> bool:
    """Whether a lock file is absent, or of a run."""
    if not lock.is_file():
        return not lock.exists()
    return lock.read_bytes()[:8] in (b"", b"process ")


def _is_same_run(config: TrainConfig) -> bool:
    """Whether the folder records no options, or those of this run."""
    if not (config.folder / "config.yaml").exists():
        return True
    try:
        return lasting(recorded(config.folder)) == lasting(config)
    except UserError:
        return False


def _names(folder: Path) -> list[str]:
    """The first names in a folder."""
    names = sorted(path.name for path in folder.iterdir())
    return [*names[:3], "..."] if len(names) > 3 else names


def check_entries(folder: Path) -> None:
    """Check that a run's folder holds only files and folders, each in its place.

    A run would write through a link or a device, wait for the reader of a pipe, and
    fail at its first save where a folder has the name of a file.

    Files with two names (hard links) are safe: they are replaced as a whole, never
    changed in place, and `manip.training.lifecycle.locked` refuses such a lock.

    Raises:
        UserError: there is something else.
    """
    for path in _entries(folder):
        if path.is_symlink():
            raise UserError(
                f"{path} is a link to {os.readlink(path)}: a run folder must not hold "
                "links; remove it"
            )
        if not path.is_file() and not path.is_dir():
            raise UserError(
                f"{path} is no file: a run folder must not hold pipes, devices or "
                "sockets; remove it"
            )
    for path in map(folder.joinpath, FILES):
        if path.is_dir():
            raise UserError(f"{path} is a folder, where a run has a file; remove it")


def _entries(folder: Path) -> Iterator[Path]:
    """What lies in a run's folder, and at any depth in the folders that it writes."""
    for path in folder.iterdir() if folder.is_dir() else ():
        yield path
        if path.name in FOLDERS and not path.is_symlink():
            yield from path.rglob("*")


def prepare(config: TrainConfig) -> None:
    """Remove what a killed writer left, and record the options, before training."""
    remove_partial(config.folder, *FOLDERS)
    text = dump_yaml(to_dict(config) | {"versions": versions()})
    write_text(config.folder / "config.yaml", text)
