"""The folder of the demo: whether to continue the run in it, or to remove it."""

import shutil
from pathlib import Path

from manip.errors import UserError
from manip.training.checkpoint import Checkpoints
from manip.training.config import recorded
from manip.training.run_logs import read_metrics

FILES = {
    "policy": "policy",
    "eval.json": "evaluation",
    "video.mp4": "video",
    "learning_curve.png": "learning curve",
    "metrics.csv": "metrics (TensorBoard: tensorboard/)",
    "config.yaml": "configuration",
}
"""What the demo makes, for its summary."""

OWN = {*FILES, "checkpoints", "tensorboard", "dumps", "run.lock"}
"""Names of everything that a demo leaves in its folder."""


def is_unfinished(folder: Path, steps: int) -> bool:
    """Whether the folder holds a run of so many control steps that has not ended."""
    if not Checkpoints(folder).exist():
        return False
    rows = read_metrics(folder / "metrics.csv")
    done = int(rows[-1]["env_steps"]) if rows else 0
    whole = steps if done < steps else steps + _extra_steps(folder)
    return recorded(folder).steps == steps and done < whole


def _extra_steps(folder: Path) -> int:
    """Control steps that --until added to the run; 0 if its checkpoint is not read."""
    try:
        return int(Checkpoints(folder).load()["progress"]["extra_steps"])
    except (UserError, KeyError):  # of another version
        return 0


def remove_finished(folder: Path) -> None:
    """Remove a finished demo, and nothing else.

    Raises:
        UserError: the folder is a link, or holds files that are not the demo's.
    """
    if not Checkpoints(folder).exist():
        return  # training starts in a folder that is its own or empty
    if folder.is_symlink():
        raise UserError(f"{folder} is a link: name the folder itself with --out")
    others = sorted(path.name for path in folder.iterdir() if not _is_own(path))
    if others:
        raise UserError(
            f"{folder} holds {', '.join(others[:3])} besides an earlier demo: move "
            "it, or choose another --out"
        )
    shutil.rmtree(folder)


def _is_own(path: Path) -> bool:
    return path.name in OWN or (path.name.startswith(".") and ".partial-" in path.name)
