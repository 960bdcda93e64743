"""Runs resume bit for bit, and refuse checkpoints that do not fit."""

import errno
import os
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from sameness import assert_same
from training_runs import (
    AGENTS,
    OFTEN,
    ROLLOUT,
    assert_equal_runs,
    assert_tensorboard_holds,
    choices,
    contents,
    copy_of,
    finished,
    new_trainer,
    rewrite,
    state_of,
    stop_after,
    tiny,
)

from manip.errors import UserError
from manip.io.tensor_trees import load_tree, save_tree
from manip.training.checkpoint import bytes_of
from manip.training.config import recorded
from manip.training.evaluator import PolicyEvaluation
from manip.training.run_logs import read_metrics


@pytest.mark.parametrize(
    ("algo", "stops"),
    # Before, at and after an evaluation; before and after SAC begins to learn.
    [
        *(("bc", (3,)), ("ppo", (4,)), ("sac", (11,))),
        *(
            pytest.param(algo, stops, marks=pytest.mark.slow)
            for algo, stops in (("ppo", (1, 2)), ("sac", (2, 1)), ("a3c", (5, 4)))
        ),
        *(
            pytest.param(algo, (3, 2), marks=pytest.mark.slow)
            for algo in sorted(AGENTS)
            if algo not in OFTEN
        ),
    ],
)
def test_an_interrupted_run_resumes_bit_for_bit(
    algo: str, stops: tuple[int, ...], tmp_path: Path
) -> None:
    config = tiny(algo, tmp_path / "run")
    for number, updates in enumerate(stops):
        trainer = new_trainer(replace(config, resume=number > 0))
        stop_after(trainer, updates)
        assert not trainer.run()
        assert trainer.state.env_steps == sum(stops[: number + 1]) * ROLLOUT[algo]
    assert new_trainer(replace(config, resume=True)).run()
    assert_equal_runs(finished(algo).folder, config.folder)


def test_a_finished_run_can_be_prolonged(tmp_path: Path) -> None:
    short = tiny("ppo", tmp_path / "run", steps=384)
    assert new_trainer(short).run()
    assert new_trainer(replace(short, steps=512, resume=True)).run()
    whole = finished("ppo").folder
    assert_same(without_rows(whole), without_rows(short.folder))
    assert choices(short.folder)[-1]["eval/return"] == choices(whole)[-1]["eval/return"]


def test_a_run_below_its_goal_goes_on_and_resumes_bit_for_bit(tmp_path: Path) -> None:
    """No episode succeeds: the run has three thirds more of its 512 steps."""
    whole = tiny("ppo", tmp_path / "whole", until=1.0)
    assert new_trainer(whole).run()
    halted = replace(whole, out=tmp_path / "halted")
    trainer = new_trainer(halted)
    stop_after(trainer, 9)
    assert not trainer.run()
    assert trainer.state.env_steps == 576 > trainer.config.steps
    resumed = new_trainer(replace(halted, resume=True))
    assert resumed.run()
    assert (resumed.state.env_steps, resumed.state.extra_steps) == (1024, 512)
    assert_equal_runs(whole.folder, halted.folder)
    ends = {int(row["env_steps"]) for row in choices(whole.folder)}
    assert ends >= {512, 704, 896, 1024}


def test_a_run_that_reaches_its_goal_ends(tmp_path: Path, monkeypatch) -> None:
    run = new_trainer(tiny("ppo", tmp_path / "run", until=0.5))
    evaluate = run.parts.evaluator._evaluate

    def succeeding(*arguments: Any) -> PolicyEvaluation:
        evaluation = evaluate(*arguments)
        return replace(evaluation, success=dict.fromkeys(evaluation.success, 0.5))

    monkeypatch.setattr(run.parts.evaluator, "_evaluate", succeeding)
    assert run.run()
    assert (run.state.env_steps, run.state.extra_steps) == (512, 0)


def without_rows(folder: Path) -> Any:
    """The last state of a run, without its rows, whose number depends on its length."""
    state = state_of(folder)
    del state["progress"]["rows"]
    return state


def test_nothing_is_not_resumed(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="nothing to resume: there is no checkpoint"):
        new_trainer(tiny("ppo", tmp_path / "run", resume=True)).run()
    assert not (tmp_path / "run").exists()


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-5])


def flip_a_bit(path: Path) -> None:
    whole = bytearray(path.read_bytes())
    whole[-99] ^= 4
    path.write_bytes(whole)


def torch_file(path: Path) -> None:
    torch.save({"format": 3}, path)


DAMAGE = [truncate, lambda path: path.write_bytes(b""), flip_a_bit, torch_file]


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_run_resumes_from_the_checkpoint_before_a_damaged_one(
    damage: Callable[[Path], Any], tmp_path: Path
) -> None:
    run = finished("ppo")
    config = copy_of(run, tmp_path / "run")
    latest = config.folder / "checkpoints" / "latest.safetensors"
    damage(latest)
    again = new_trainer(replace(config, resume=True))
    with pytest.warns(
        UserWarning, match=f"{latest} is damaged.*; trying the checkpoint bef"
    ):
        assert again.run()
    assert_equal_runs(run.folder, config.folder)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: [1], "has format None, expected 7"),
        (lambda t: t | {"format": 0}, "has format 0, expected 7"),
        (lambda t: t | {"collector": {}}, "is of another configuration"),
        (lambda t: t | {"torch_rng": 3}, "is of another configuration"),
        (lambda t: t | {"progress": {}}, "is damaged"),
        (lambda t: t | {"config": 7}, "is damaged"),
    ],
)
def test_a_checkpoint_that_does_not_fit_is_refused_and_costs_nothing(
    change: Callable[[Any], Any], message: str, tmp_path: Path
) -> None:
    config = copy_of(finished("ppo"), tmp_path / "run")
    latest = config.folder / "checkpoints" / "latest.safetensors"
    save_tree(latest, change(load_tree(latest)))
    before = contents(config.folder)
    with pytest.raises(UserError, match=message):
        new_trainer(replace(config, resume=True)).run()
    assert contents(config.folder) == before


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seed": 1}, "seed was 0, not 1"),
        ({"num_envs": 3, "reward": "stock"}, "num_envs was 4, not 3; reward was"),
        ({"agent": {"gamma": 0.5}}, "agent.gamma was 0.97, not 0.5"),
        ({"algo": "sac"}, "algo was 'ppo', not 'sac'"),
    ],
)
def test_a_run_does_not_resume_with_other_options(
    change: dict[str, Any], message: str, tmp_path: Path
) -> None:
    change = dict(change)
    folder = copy_of(finished("ppo"), tmp_path / "run").folder
    other = tiny(change.pop("algo", "ppo"), folder, resume=True, **change)
    before = contents(folder)
    with pytest.raises(
        UserError, match=f"cannot be resumed with other options: .*{message}"
    ):
        new_trainer(other).run()
    assert contents(folder) == before


def test_a_run_from_before_an_option_resumes_with_its_default(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    trainer = new_trainer(tiny("ppo", folder))
    stop_after(trainer, 5)
    assert not trainer.run()

    def forget(tree: Any) -> None:
        del tree["config"]["collectors"], tree["config"]["agent.squash"]

    rewrite(folder / "checkpoints" / "latest.safetensors", forget)
    text = (folder / "config.yaml").read_text()
    text = re.sub(r"^(collectors|  squash): .*\n", "", text, flags=re.MULTILINE)
    (folder / "config.yaml").write_text(text)
    assert "collectors" not in text
    assert "squash" not in text
    resumed = replace(recorded(folder), out=folder, resume=True)
    with pytest.raises(UserError, match="collectors was 1, not 2"):
        new_trainer(replace(resumed, collectors=2)).run()
    assert new_trainer(resumed).run()
    assert_equal_runs(finished("ppo").folder, folder)


def test_a_run_that_resumes_with_other_versions_warns(tmp_path: Path) -> None:
    config = copy_of(finished("ppo"), tmp_path / "run")
    latest = config.folder / "checkpoints" / "latest.safetensors"
    rewrite(latest, lambda tree: tree["versions"].update(mujoco="2.0"))
    with pytest.warns(UserWarning, match=r"mujoco was 2.0, is .*not bit for bit"):
        assert new_trainer(replace(config, resume=True)).run()


def test_a_run_that_a_full_disk_ended_resumes_bit_for_bit(
    tmp_path: Path, monkeypatch
) -> None:
    config = tiny("ppo", tmp_path / "run")
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    room = iter([None] * 12)

    def fsync(handle: int) -> None:
        if next(room, full):
            raise full

    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", fsync)
        message = f"No space left on device; .*--resume --out {config.folder}"
        with pytest.raises(UserError, match=message):
            new_trainer(config).run()
    assert new_trainer(replace(config, resume=True)).run()
    assert_equal_runs(finished("ppo").folder, config.folder)


def test_logs_of_a_resumed_run_hold_every_row_once(tmp_path: Path) -> None:
    run = finished("ppo")
    config = copy_of(run, tmp_path / "run")
    table = config.folder / "metrics.csv"
    expected = read_metrics(table)
    table.write_text(table.read_text()[:-7] + "1,2,3\n5")
    for events in (config.folder / "tensorboard").iterdir():
        events.write_bytes(events.read_bytes()[:-9])
    assert new_trainer(replace(config, resume=True)).run()
    assert read_metrics(table) == expected
    assert_tensorboard_holds(expected, config.folder)


def test_a_run_resumes_without_the_buffer_that_was_not_saved(
    tmp_path: Path, capsys
) -> None:
    config = tiny("sac", tmp_path / "run", save_buffer=False)
    trainer = new_trainer(config)
    stop_after(trainer, 11)
    assert not trainer.run()
    assert "replay buffer" not in capsys.readouterr().err
    lean = trainer.checkpoints.latest.stat().st_size
    again, counts = new_trainer(replace(config, save_buffer=True, resume=True)), []
    update = again.parts.agent.update

    def counted(batch: Any) -> dict[str, float]:
        values = update(batch)
        counts.append(again.parts.agent.extra_state()["updates"])
        return values

    again.parts.agent.update = counted
    with pytest.warns(UserWarning, match="holds no replay buffer: it is filled anew"):
        assert again.run()
    first, second, third, fourth, fifth = counts
    assert 0 < first == second == third < fourth < fifth
    printed = capsys.readouterr().err
    assert re.search(r"MiB \(replay buffer: .*--no-save-buffer\)", printed)
    rows = state_of(config.folder)["agent"]["buffer"]
    assert trainer.checkpoints.latest.stat().st_size > lean + bytes_of(rows) / 2
