"""Clips: cut from rollouts, stored, repeated bit for bit; damaged files are refused."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from clip_files import LENGTH, cut_all, recorded
from tensordict import TensorDictBase

from manip.envs.backends.external_batch import ExternalBatch
from manip.envs.external_task import load_external
from manip.errors import DamagedError, UserError
from manip.io.tensor_trees import load_tree, save_tree
from manip.preferences import clip_player
from manip.preferences.clip_player import ClipPlayer
from manip.preferences.clip_pool import cut_clips
from manip.preferences.clip_source import ClipSource
from manip.preferences.clips import (
    MOST_STEPS,
    Clip,
    clip_ids,
    clip_path,
    load_clip,
    save_clip,
)
from manip.sim import gl
from manip.sim.external.dm_control_sim import ROBOT


@pytest.fixture(scope="module", params=["Lift", "Wipe"])
def rollout(request) -> tuple[ClipSource, TensorDictBase]:
    """Wipe has a memory and a hundred model fields."""
    return recorded(request.param)


@pytest.fixture(scope="module")
def clips(rollout: tuple[ClipSource, TensorDictBase]) -> list[Clip]:
    return cut_all(*rollout)


@pytest.fixture(scope="module")
def clip() -> Clip:
    return cut_all(*recorded("Lift"))[1]


def test_clips_do_not_span_two_episodes(rollout) -> None:
    source, steps = rollout
    eights = cut_clips(steps, 8, source, "expert")
    assert _places(eights) == [(env, 0, step) for step in (0, 8) for env in range(3)]
    fours = cut_clips(steps, 4, source, "expert")
    first = [(env, 0, step) for step in (0, 4, 8, 12, 16) for env in range(3)]
    assert _places(fours) == first + [(env, 1, 0) for env in range(3)]
    assert not cut_clips(steps, 21, source, "expert")


def _places(clips: list[Clip]) -> list[tuple[int, int, int]]:
    headers = [clip.header for clip in clips]
    return [(header.env, header.episode, header.step) for header in headers]


def test_a_clip_says_where_it_comes_from(clip: Clip) -> None:
    header = clip.header
    assert (header.task, header.env, header.episode, header.step) == ("Lift", 0, 0, 8)
    assert (header.seed, header.purpose, header.actor) == (5, "training", "expert")
    assert clip.steps == LENGTH == len(clip.qpos) - 1
    assert clip.measure("hand_speed").max() > 0.01


def test_the_reward_is_that_of_the_rollout(rollout, clips: list[Clip]) -> None:
    _, steps = rollout
    expected = steps["next", "reward"][0, LENGTH : 2 * LENGTH, 0]
    np.testing.assert_allclose(clips[1].reward, expected, 1e-6, 1e-7)


def test_a_clip_is_measured_again_bit_for_bit(
    clips: list[Clip], tmp_path: Path
) -> None:
    player = ClipPlayer(tmp_path)
    for clip in clips:
        measures, terms = player.measure_again(clip)
        assert np.array_equal(measures, clip.measures)
        assert np.array_equal(terms, clip.reward_terms)


def test_a_file_holds_the_same_clip(clip: Clip, tmp_path: Path) -> None:
    clip_id = save_clip(tmp_path, clip)
    assert save_clip(tmp_path, clip) == clip_id
    assert clip_ids(tmp_path) == [clip_id]
    loaded = load_clip(tmp_path, clip_id)
    assert loaded.header == clip.header
    for name, array in clip.arrays().items():
        assert np.array_equal(getattr(loaded, name), array)


def test_ids_differ_with_every_content(clip: Clip) -> None:
    others = [
        replace(clip, header=replace(clip.header, actor="another")),
        replace(clip, header=replace(clip.header, step=9)),
        *(replace(clip, **{n: a + 1}) for n, a in clip.arrays().items()),
    ]
    assert len({clip.id, *(other.id for other in others)}) == len(others) + 1


def test_a_clip_is_drawn(clip: Clip, tmp_path: Path) -> None:
    if not gl.find_backend():
        return
    frames = list(ClipPlayer(tmp_path).frames(clip, width=64, height=48))
    assert len(frames) == LENGTH + 1
    assert frames[0].shape == (48, 64, 3)
    assert (frames[0] != frames[-1]).any()


def test_other_libraries_have_no_clips() -> None:
    task = load_external("dm_control/reach_site_features")
    batch = ExternalBatch(task, 1, robot=ROBOT, threads=1)
    with pytest.raises(UserError, match="states of the batch engine"):
        ClipSource.of(batch, task.name)


# Files of other origin


@pytest.mark.parametrize("name", ["../secret", "a" * 23, "A" * 24, "/etc/x", 5, ""])
def test_an_id_cannot_leave_the_folder(name: Any, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="is no id of a clip"):
        load_clip(tmp_path, name)


def test_a_missing_clip_is_named(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="there is no file"):
        load_clip(tmp_path, "0" * 24)


def set_array(name: str, change: Callable[[Any], Any]) -> Callable[[dict], None]:
    return lambda tree: tree.__setitem__(name, change(tree[name]))


def set_header(**values: Any) -> Callable[[dict], None]:
    return lambda tree: tree["header"].update(values)


HOSTILE = {
    "NaN": (set_array("qpos", lambda a: a * np.nan), "not finite"),
    "infinite": (set_array("action", lambda a: a + np.float32(np.inf)), "not finite"),
    "shape": (set_array("qpos", lambda a: a[:-1]), "qpos has shape"),
    "axes": (set_array("states", lambda a: a[None]), "states has shape"),
    "dtype": (set_array("measures", lambda a: a.astype(np.float64)), "float32"),
    "no array": (set_array("measures", lambda a: [1, 2]), "measures is no array"),
    "short": (set_array("action", lambda a: a[:0]), "a clip has 1 to"),
    "long": (
        set_array("action", lambda a: np.tile(a, (MOST_STEPS, 1))),
        "a clip has 1 to",
    ),
    "missing": (lambda tree: tree.pop("motion"), "it holds"),
    "additional": (lambda tree: tree.update(more=1), "it holds"),
    "format": (set_header(format=9), "it has format 9"),
    "option": (set_header(colour="red"), "colour"),
    "kind": (set_header(seed="5"), "seed must be"),
    "range": (set_header(step=-1), "step must be"),
    "markup": (set_header(actor="<script>"), "no plain name"),
    "escape": (set_header(measure_names=["\x1b[2J"]), "no plain name"),
    "robot": (set_header(robot="Hal"), "robot"),
    "purpose": (set_header(purpose="fun"), "purpose"),
    "names": (set_header(measure_names=["speed"]), "measures has shape"),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_a_hostile_file_is_refused(case: str, clip: Clip, tmp_path: Path) -> None:
    change, message = HOSTILE[case]
    path = clip_path(tmp_path, save_clip(tmp_path, clip))
    tree = load_tree(path)
    change(tree)
    save_tree(path, tree)
    with pytest.raises(DamagedError, match=message):
        load_clip(tmp_path, clip.id)


def test_a_clip_under_another_name_is_refused(clip: Clip, tmp_path: Path) -> None:
    path = clip_path(tmp_path, save_clip(tmp_path, clip))
    path.rename(path.with_name(f"{'0' * 24}.safetensors"))
    with pytest.raises(DamagedError, match=f"have the id {clip.id}"):
        load_clip(tmp_path, "0" * 24)


def test_a_changed_byte_is_noticed(clip: Clip, tmp_path: Path) -> None:
    path = clip_path(tmp_path, save_clip(tmp_path, clip))
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)
    with pytest.raises(DamagedError, match="checksum"):
        load_clip(tmp_path, clip.id)


def test_a_large_file_is_not_read(clip: Clip, tmp_path: Path) -> None:
    path = clip_path(tmp_path, save_clip(tmp_path, clip))
    with path.open("r+b") as file:
        file.truncate(2**24 + 1)
    with pytest.raises(DamagedError, match="larger than"):
        load_clip(tmp_path, clip.id)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"states": np.zeros(3)}, "states of the saved state"),
        ({"qpos": np.zeros((LENGTH + 1, 3))}, "3 joint coordinates"),
        ({"action": np.zeros((LENGTH, 2), np.float32)}, "actions of 2 numbers"),
    ],
)
def test_a_clip_that_does_not_fit_its_task_is_refused(
    change: dict[str, Any], message: str, clip: Clip, tmp_path: Path
) -> None:
    with pytest.raises(UserError, match=message):
        ClipPlayer(tmp_path).measure_again(replace(clip, **change))


def test_code_that_came_with_the_clips_is_not_run(
    clip: Clip, tmp_path: Path, monkeypatch
) -> None:
    (tmp_path / "evil.py").write_text("raise SystemExit('run')")
    monkeypatch.syspath_prepend(tmp_path)
    other = replace(clip, header=replace(clip.header, task="evil:Task"))
    with pytest.raises(UserError, match="No module named 'evil'"):
        clip_player.ClipPlayer(tmp_path).measure_again(other)
