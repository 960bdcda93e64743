"""The learning curve of a run: its picture, and what drawing it leaves alone."""

import subprocess
import sys
from pathlib import Path

import numpy as np
from PIL import Image

from manip.evaluation.learning_curve import plot_learning_curve

MEASURES = ("success_once", "success_held", "success_at_end", "return")


def row(env_steps: int, value: float) -> dict[str, str]:
    """A row of metrics.csv with an evaluation of this value."""
    values = {f"eval/{measure}": str(value) for measure in MEASURES}
    return {"env_steps": str(env_steps), "seconds": str(env_steps / 100)} | values


def test_the_picture_shows_the_evaluations(tmp_path: Path) -> None:
    without = {"env_steps": "50", "seconds": "1", "eval/success_held": ""}
    pictures = []
    for last in (0.1, 0.9):
        path = tmp_path / "new" / f"{last}.png"
        rows = [row(1000, 0.1), without, row(2000, last)]
        plot_learning_curve(rows, "Lift", path)
        pictures.append(np.asarray(Image.open(path)))
    assert pictures[0].shape == pictures[1].shape
    assert (pictures[0] != pictures[1]).any()


def test_drawing_leaves_the_users_matplotlib_alone() -> None:
    code = (
        "import matplotlib, sys; matplotlib.use('svg'); "
        "import manip.evaluation.learning_curve; "
        "assert matplotlib.get_backend() == 'svg'; "
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    subprocess.run(
        [sys.executable, "-c", code], check=True, cwd=Path(__file__).parents[1]
    )
