"""Runs with preferences: rounds of labels, people's answers, exact resuming."""

import os
from dataclasses import replace
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import pytest
import torch
from clip_files import LENGTH, cut_all, recorded
from tensordict import TensorDictBase
from training_runs import (
    assert_equal_runs,
    new_trainer,
    shared_scene,
    stop_after,
    tiny,
)

from manip.envs.backends import native_batch
from manip.errors import DamagedError, UserError
from manip.io.json_lines import append_lines, read_lines
from manip.io.yaml_files import dump_yaml
from manip.preferences import label_folder
from manip.preferences.clips import load_clip, save_clip
from manip.preferences.comparisons import append_comparison, valid_comparisons
from manip.preferences.label_folder import LabelFolder
from manip.preferences.labellers import TasteCriterion, make_labeller
from manip.preferences.pair_queue import read_pairs
from manip.training import config as config_module
from manip.training import preferences
from manip.training.config import TrainConfig, from_dict
from manip.training.preferences import run_id
from manip.training.run import RunResult, train
from manip.training.trainer import Trainer

LABELS = {
    "labeller": "oracle",
    "total": 14,
    "first": 8,
    "per_round": 6,
    "start": 128,
    "every": 96,
    "clip_steps": 5,
    "recent": 200,
}
AGENTS = {"ppo-kl": {"critic_rollouts": 1}, "sac": {"random_steps": 192}}


def config_of(
    out: Path, algo: str = "ppo-kl", labels: dict[str, Any] | None = None, **rest: Any
) -> TrainConfig:
    return tiny(
        algo,
        out / "run",
        preferences=str(out / "labels"),
        labels=LABELS | (labels or {}),
        agent=AGENTS[algo],
        **{"eval_every": 384, "steps": 384} | rest,
    )


def files_of(folder: Path) -> dict[str, Any]:
    """What a folder of preferences holds, without the clock's times and run's id."""
    pairs = [(pair.round, pair.left, pair.right) for pair in read_pairs(folder)]
    answers = [(c.left, c.right, c.answer) for c in valid_comparisons(folder)]
    used = [
        (line["round"], line["lines"]) for line in read_lines(folder / "rounds.jsonl")
    ]
    clips = sorted(path.name for path in (folder / "clips").iterdir())
    return {"pairs": pairs, "answers": answers, "used": used, "clips": clips}


def learned(trainer: Trainer) -> list[float]:
    return [row.get("learn/labels", 0) for row in trainer.state.rows]


@pytest.mark.parametrize("algo", AGENTS)
def test_a_run_learns_from_labels_in_rounds(algo: str, tmp_path: Path) -> None:
    trainer = new_trainer(config_of(tmp_path, algo))
    assert trainer.run()
    files = files_of(tmp_path / "labels")
    assert [sum(p[0] == n for p in files["pairs"]) for n in range(2)] == [8, 6]
    assert files["used"] == [(0, 8), (1, 14)]
    assert len(files["answers"]) == 14
    assert learned(trainer)[-1] == 14
    assert trainer.state.learned["learned_reward"] != 0


def test_the_tasks_reward_is_paid_beside_the_learned_one(tmp_path: Path) -> None:
    trainer = new_trainer(config_of(tmp_path, labels={"task_reward": 0.5}))
    agent = trainer.parts.agent
    outer, inner, task, paid = agent.update, agent._agent.update, [], []

    def before(batch: TensorDictBase) -> dict[str, float]:
        task.append(batch["next", "reward"].clone())
        return outer(batch)

    def after(batch: TensorDictBase) -> dict[str, float]:
        expected = agent._rounds.model(batch) + 0.5 * task[-1]
        torch.testing.assert_close(batch["next", "reward"], expected)
        paid.append(expected)
        return inner(batch)

    agent.update, agent._agent.update = before, after
    assert trainer.run()
    assert paid


def killed(monkeypatch: pytest.MonkeyPatch, where: str, times: int) -> None:
    """Have a function of the rounds fail as a killed process does: without effect."""
    module, name = where.rsplit(".", 1)
    target = {"label_folder": label_folder, "LabelFolder": LabelFolder}[module]
    original, count = getattr(target, name), iter(range(1, times + 1))

    def dies(*args: Any, **kwargs: Any) -> Any:
        if next(count, 0) == times:
            raise KeyboardInterrupt
        return original(*args, **kwargs)

    monkeypatch.setattr(target, name, dies)


KILLS = [
    ("label_folder.append_comparison", 11),
    ("label_folder.append_comparison", 3),
    ("label_folder.append_pairs", 2),
    ("label_folder.append_lines", 1),
    ("label_folder.append_lines", 2),
    ("LabelFolder.answers", 2),
]
"""Functions that write to the folder, and at which of their calls a run is killed."""


@pytest.mark.parametrize(
    ("algo", "where", "times"),
    [
        ("ppo-kl", *KILLS[0]),
        *(
            pytest.param(algo, *kill, marks=pytest.mark.slow)
            for algo in AGENTS
            for kill in KILLS
        ),
    ],
)
def test_a_run_killed_between_labels_goes_on_as_if_it_had_not_been(
    algo: str, where: str, times: int, tmp_path: Path
) -> None:
    whole = config_of(tmp_path / "whole", algo)
    assert new_trainer(whole).run()
    config = config_of(tmp_path / "killed", algo)
    trainer = new_trainer(config)
    with pytest.MonkeyPatch.context() as patch:
        killed(patch, where, times)
        with pytest.raises(KeyboardInterrupt):
            trainer.run()
    assert new_trainer(replace(config, resume=True)).run()
    assert files_of(tmp_path / "whole/labels") == files_of(tmp_path / "killed/labels")
    assert_equal_runs(whole.folder, config.folder)


@pytest.mark.slow
@pytest.mark.parametrize("algo", AGENTS)
def test_a_stopped_run_resumes_bit_for_bit(algo: str, tmp_path: Path) -> None:
    whole = config_of(tmp_path / "whole", algo)
    assert new_trainer(whole).run()
    config = config_of(tmp_path / "parts", algo)
    for number, updates in enumerate((1, 2, 1)):
        trainer = new_trainer(replace(config, resume=number > 0))
        stop_after(trainer, updates)
        assert not trainer.run()
    assert new_trainer(replace(config, resume=True)).run()
    assert files_of(tmp_path / "whole/labels") == files_of(tmp_path / "parts/labels")
    assert_equal_runs(whole.folder, config.folder)


def run(config: TrainConfig) -> RunResult:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(native_batch, "load_scene", shared_scene)
        return train(config)


def answer_all(folder: Path, labeller: str = "person") -> None:
    judge_of = make_labeller("oracle", TasteCriterion())
    answered = {answer.pair for answer in valid_comparisons(folder)}
    for pair in read_pairs(folder):
        if frozenset((pair.left, pair.right)) not in answered:
            clips = [load_clip(folder, clip) for clip in (pair.left, pair.right)]
            ids = pair.left, pair.right
            append_comparison(folder, labeller, ids, judge_of(*clips), 2.0, pair.round)


def test_a_run_waits_for_people_and_goes_on_as_with_a_labeller(tmp_path: Path) -> None:
    """Bit for bit, but for the options: who labels, and the identity of the run."""
    told_at_once = config_of(tmp_path / "oracle")
    assert new_trainer(told_at_once).run()
    config = config_of(tmp_path / "people", labels={"labeller": "people"})
    folder, waited = tmp_path / "people/labels", []
    result = run(config)
    while result.waiting:
        assert not result.finished
        waited.append(result.waiting)
        assert run(replace(config, resume=True)).waiting == result.waiting
        answer_all(folder)
        result = run(replace(config, resume=True))
    assert result.finished
    assert [text.split(":")[0] for text in waited] == [
        f"{count} pairs of clips wait for answers" for count in (8, 6)
    ]
    assert waited[0].endswith(f"manip label {folder}")
    assert files_of(tmp_path / "oracle/labels") == files_of(folder)
    policies = [
        (each / "run/policy/policy.safetensors").read_bytes()
        for each in (tmp_path / "oracle", tmp_path / "people")
    ]
    assert policies[0] == policies[1]


@pytest.mark.slow
def test_answers_that_a_folder_holds_are_used_and_not_asked_for(tmp_path: Path) -> None:
    assert new_trainer(config_of(tmp_path)).run()
    again = replace(config_of(tmp_path), out=tmp_path / "again", seed=1)
    trainer = new_trainer(again)
    assert trainer.run()
    assert len(valid_comparisons(tmp_path / "labels")) == 14
    assert learned(trainer)[-1] == 14


@pytest.mark.slow
def test_answers_that_were_added_later_do_not_change_a_resumed_run(
    tmp_path: Path,
) -> None:
    whole = config_of(tmp_path / "whole")
    assert new_trainer(whole).run()
    config = config_of(tmp_path / "parts")
    trainer = new_trainer(config)
    stop_after(trainer, 1)  # and what the later rounds leave in the folder, too
    assert not trainer.run()
    first = (config.folder / "checkpoints/latest.safetensors").read_bytes()
    assert new_trainer(replace(config, resume=True)).run()
    for name in ("latest", "previous", "best"):
        (config.folder / f"checkpoints/{name}.safetensors").write_bytes(first)
    pair = read_pairs(tmp_path / "parts/labels")[0]
    append_comparison(tmp_path / "parts/labels", "b", (pair.left, pair.right), "equal")
    assert new_trainer(replace(config, resume=True)).run()
    assert_equal_runs(whole.folder, config.folder)


def test_an_option_that_is_new_changes_no_runs_identity(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    one, other = config_of(tmp_path), config_of(tmp_path, seed=9)
    before, original = run_id(one), config_module.lasting
    assert run_id(other) != before
    for module in (config_module, preferences):
        monkeypatch.setattr(module, "lasting", lambda c: original(c) | {"new": 1})
    assert run_id(one) == before


def test_lost_answers_are_said(tmp_path: Path) -> None:
    folder = LabelFolder(tmp_path, "run")
    append_comparison(tmp_path, "a", ("0" * 24, "1" * 24), "left")
    append_comparison(tmp_path, "a", ("0" * 24, "2" * 24), "left")
    assert len(folder.answers(0)) == 2
    path = tmp_path / "comparisons.jsonl"
    path.write_text(path.read_text().splitlines(keepends=True)[0])
    with pytest.raises(DamagedError, match=r"has used 2 comparisons.*only 1"):
        folder.answers(0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"labels": {"taste": "spicy"}}, "taste"),
        ({"labels": {"start": 1, "clip_steps": 50}}, "only 0 clips to compare"),
    ],
)
def test_what_cannot_work_is_refused(
    changes: dict[str, Any], message: str, tmp_path: Path
) -> None:
    with pytest.raises(UserError, match=message):
        new_trainer(config_of(tmp_path, **changes)).run()


@pytest.mark.parametrize(
    ("algo", "message"),
    [
        ("bc", "learns from actions, not from a reward"),
        ("a3c", "learns while it collects"),
        ("dpo", "name it with --agent.reference"),
    ],
)
def test_algorithms_that_cannot_learn_from_preferences_say_so(
    algo: str, message: str, tmp_path: Path
) -> None:

    values = {"task": "Reach", "algo": algo, "out": str(tmp_path / "run")}
    config = from_dict(values | {"preferences": str(tmp_path / "labels")})
    with pytest.raises(UserError, match=message):
        Trainer(config, print, None, Event())


@pytest.mark.parametrize("algo", ["pebble", "dpo", "clone-best"])
def test_algorithms_of_preferences_need_a_folder(algo: str, tmp_path: Path) -> None:

    config = from_dict({"task": "Reach", "algo": algo, "out": str(tmp_path / "run")})
    with pytest.raises(UserError, match="give a folder for them with --preferences"):
        Trainer(config, print, None, Event())


def test_labels_need_a_folder_of_preferences(tmp_path: Path) -> None:
    config = tiny("sac", tmp_path / "run", labels=LABELS)
    with pytest.raises(UserError, match="--labels has no effect without --preferences"):
        new_trainer(config)


def test_a_file_is_no_folder_of_preferences(tmp_path: Path) -> None:
    (tmp_path / "labels").write_text("")
    with pytest.raises(UserError, match=r"--preferences .*labels is not a folder"):
        new_trainer(config_of(tmp_path))


@pytest.mark.parametrize("name", ["comparisons", "queries", "rounds"])
def test_a_folder_whose_files_cannot_be_read_is_refused_before_the_run(
    name: str, tmp_path: Path
) -> None:
    (tmp_path / "labels").mkdir()
    os.mkfifo(tmp_path / f"labels/{name}.jsonl")
    with pytest.raises(UserError, match=rf"{name}\.jsonl is no regular file"):
        LabelFolder(tmp_path / "labels", "run").check()
    with pytest.raises(UserError, match="is no regular file"):
        append_lines(tmp_path / f"labels/{name}.jsonl", [])


def test_answers_to_other_clips_are_refused_before_the_run(tmp_path: Path) -> None:
    folder = tmp_path / "labels"
    clips = cut_all(*recorded("Lift"))[:2]
    append_comparison(folder, "Ada", tuple(save_clip(folder, c) for c in clips), "left")
    with pytest.raises(UserError, match="has task Lift, not Reach"):
        new_trainer(config_of(tmp_path))


@pytest.mark.parametrize(
    ("header", "columns", "message"),
    [
        ({"control_freq": 10}, 0, "has robot Panda OSC_POSE 10 Hz, not Panda OSC_POSE"),
        ({}, 1, "has observation and action of"),
    ],
)
def test_clips_of_another_controller_or_observation_are_refused(
    header: dict[str, Any], columns: int, message: str, tmp_path: Path
) -> None:
    folder = tmp_path / "labels"
    clips = [
        replace(
            clip,
            header=replace(clip.header, **header),
            observation=np.pad(clip.observation, ((0, 0), (0, columns))),
        )
        for clip in cut_all(*recorded("Reach"))[:2]
    ]
    append_comparison(folder, "Ada", tuple(save_clip(folder, c) for c in clips), "left")
    with pytest.raises(UserError, match=message):
        new_trainer(config_of(tmp_path, labels={"clip_steps": LENGTH}))


def test_a_taste_of_other_measures_is_refused_before_the_run(tmp_path: Path) -> None:
    taste = tmp_path / "mine.yaml"
    term = {"measure": "object_height", "above": 0.1, "full": 0.1, "weight": 1.0}
    taste.write_text(dump_yaml({"words": "Low.", "terms": [term]}))
    with pytest.raises(UserError, match="unknown measure 'object_height'"):
        new_trainer(config_of(tmp_path, labels={"taste": str(taste)}))


def test_a_run_goes_on_with_no_other_folder_than_its_own(tmp_path: Path) -> None:
    config = config_of(tmp_path)
    trainer = new_trainer(config)
    stop_after(trainer, 3)
    assert not trainer.run()
    assert read_lines(tmp_path / "labels/rounds.jsonl")
    (tmp_path / "labels").rename(tmp_path / "moved")
    with pytest.raises(UserError, match="does not hold the comparisons of round 0"):
        new_trainer(replace(config, resume=True)).run()
    moved = replace(config, resume=True, preferences=tmp_path / "moved")
    assert new_trainer(moved).run()
