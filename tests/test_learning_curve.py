"""The learning curve of a run: its picture, and what drawing it leaves alone."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from manip.evaluation.learning_curve import plot_learning_curve

MEASURES = ("success_once", "success_held", "success_at_end", "return")


def row(env_steps: int, value: float, kind: str = "eval") -> dict[str, float]:
    """A row of metrics.csv with rates of this value."""
    rates = {f"{kind}/{name}": value for name in (*MEASURES, "near")}
    return {"env_steps": env_steps, "seconds": env_steps / 100} | rates


@pytest.mark.parametrize("kind", ["train", "curve", "eval"])
def test_the_picture_shows_training_and_evaluations(kind: str, tmp_path: Path) -> None:
    others = [row(500, 0.4, "train"), {"env_steps": 600.0, "seconds": 6.0}]
    pictures = []
    for last in (0.1, 0.9):
        path = tmp_path / "new" / f"{last}.png"
        plot_learning_curve([*others, row(2000, last, kind)], "Lift", path)
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
