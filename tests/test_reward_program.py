"""`manip reward`: a reward is learned from a folder, judged, and drawn."""

from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
import torch
from clip_files import LENGTH, cut_all, recorded, with_measures

from manip.errors import UserError
from manip.preferences.clips import save_clip
from manip.preferences.comparisons import append_comparison
from manip.preferences.reward_model import FILE, load_reward_model
from manip.programs import reward

TILTS = np.linspace(0, 1, 10)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Clips that differ in the hand's tilt only; the more upright one is better."""
    clip = cut_all(*recorded("Lift", steps=LENGTH, num_envs=1))[0]
    ids = [
        save_clip(tmp_path, with_measures(clip, step, hand_tilt=tilt))
        for step, tilt in enumerate(TILTS)
    ]
    for number, (upright, tilted) in enumerate(combinations(ids, 2)):
        if number % 2:
            append_comparison(tmp_path, "Ada", (upright, tilted), "left")
        else:
            append_comparison(tmp_path, "Ada", (tilted, upright), "right")
    return tmp_path


def test_a_reward_is_learned_judged_and_drawn(folder: Path, capsys) -> None:
    assert reward.main([str(folder), "--members", "2", "--folds", "3"]) == 0
    text = capsys.readouterr().out
    assert f"Lift, clips of {LENGTH} steps: 22 left, 23 right" in text
    assert "agreement with own earlier answers: no repeated pairs" in text
    assert (folder / "reward.png").stat().st_size > 0
    model = load_reward_model(folder / FILE)
    steps = torch.zeros(len(TILTS), len(model.card.names)) + model.network.mean
    steps[:, model.card.names.index("hand_tilt")] = torch.from_numpy(TILTS).float()
    assert (model.network.paid(steps).diff() < 0).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--folds", "1"], "--folds must be"),
        (["--seed", "-1"], "--seed must be at least 0"),
        (["--plot", "reward.xyz"], "unknown file format '.xyz'"),
        ([], "holds 0 comparisons: at least 5 are needed"),
    ],
)
def test_mistakes_are_refused(arguments, message: str, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=message):
        reward.main([str(tmp_path), *arguments])


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"there is no folder .*nowhere"):
        reward.main([str(tmp_path / "nowhere")])


def test_skipped_pairs_do_not_count(tmp_path: Path) -> None:
    clips = [save_clip(tmp_path, clip) for clip in cut_all(*recorded("Lift"))[:4]]
    for answer, right in zip(("left", "skip", "skip"), clips[1:], strict=True):
        append_comparison(tmp_path, "Ada", (clips[0], right), answer)
    with pytest.raises(UserError, match="only 1 of the 3 comparisons"):
        reward.main([str(tmp_path), "--folds", "3"])
