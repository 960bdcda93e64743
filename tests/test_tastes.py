"""Tastes: penalties on visible measures, from files that are checked."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from manip.envs.backends.native_batch import NativeBatch
from manip.envs.task_registry import load_task
from manip.errors import UserError
from manip.evaluation import runners
from manip.evaluation.runners import EpisodeSettings, make_env
from manip.io.yaml_files import dump_yaml
from manip.preferences.tastes import (
    MOST_EXCESS,
    load_taste,
    read_taste,
    shipped_tastes,
    taste_names,
)
from manip.programs import cli, main
from manip.robot_config import RobotConfig

Array = np.ndarray

TERM = {"measure": "speed", "above": 0.1, "full": 0.2, "weight": 0.5}
TASTE: dict[str, Any] = {"words": "Slowly.", "terms": [TERM]}


def penalties(taste: dict[str, Any], **measures: list[float]) -> list[float]:
    values = np.stack(list(map(np.array, measures.values())), axis=-1)
    result = read_taste(taste, "a test").penalties(values, tuple(measures))
    return [round(float(each), 6) for each in result]


def test_a_penalty_grows_with_the_excess_up_to_a_limit() -> None:
    speed = [0.0, 0.1, 0.2, 0.3, 0.7, 9.0]
    expected = [0, 0, 0.25, 0.5, 0.5 * MOST_EXCESS, 0.5 * MOST_EXCESS]
    assert penalties(TASTE, speed=speed) == expected


def test_below_a_threshold() -> None:
    high = {"measure": "height", "below": 0.2, "full": 0.1, "weight": 1.0}
    taste = {"words": "High.", "terms": [high]}
    assert penalties(taste, height=[0.3, 0.2, 0.15, 0.0]) == [0, 0, 0.5, 2]


def test_only_during_what_is_named() -> None:
    term = TERM | {"during": {"grip": 1.0, "far": 0.1}}
    taste = {"words": "Slowly with the cube.", "terms": [term]}
    given = penalties(taste, speed=[0.3] * 4, grip=[1, 0.5, 1, 0], far=[0.2, 0.2, 0, 0])
    assert given == [0.5, 0, 0, 0]


def test_terms_add_up() -> None:
    more = {"measure": "tilt", "above": 0.0, "full": 1.0, "weight": 1.0}
    taste = {"words": "Slowly, upright.", "terms": [TERM, more]}
    assert penalties(taste, tilt=[0.5], speed=[0.3]) == [1.0]


@pytest.mark.parametrize("named", shipped_tastes())
def test_shipped_tastes_are_about_measures_of_their_task(named: str, scene_of) -> None:
    task_name, name = named.split(": ")
    task = load_task(task_name)
    batch = NativeBatch(task, 2, scene=scene_of(task), threads=1)
    batch.begin(np.arange(2))
    batch.step(batch.expert())
    taste = load_taste(task_name, name)
    assert taste.words.endswith(".")
    given = taste.penalties(batch.measures(), batch.measure_names)
    assert given.shape == (2,)
    assert (given >= 0).all()


def test_a_taste_that_does_not_exist() -> None:
    with pytest.raises(UserError, match="known Lift tastes: gentle, upright"):
        load_taste("Lift", "gentel")
    with pytest.raises(UserError, match="Reach has none; shipped ones are Lift: gen"):
        load_taste("Reach", "gentle")
    with pytest.raises(UserError, match="there is no file mine"):
        load_taste("Reach", "mine.yaml")
    assert taste_names("robosuite/Lift") == taste_names("../tastes/Lift") == []


def test_a_taste_of_ones_own(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(dump_yaml(TASTE))
    assert load_taste("Reach", str(path)).words == "Slowly."


def test_a_measure_that_the_task_lacks() -> None:
    with pytest.raises(UserError, match=r"unknown measure .speed..*height"):
        penalties(TASTE, height=[0.1])


WRONG: dict[str, Any] = {
    "no mapping": [TASTE],
    "no terms": {"words": "Slowly."},
    "empty": TASTE | {"terms": []},
    "threshold": TASTE | {"terms": [{k: TERM[k] for k in TERM if k != "above"}]},
    "two": TASTE | {"terms": [TERM | {"below": 1.0}]},
    "name": TASTE | {"terms": [TERM | {"over": 1.0}]},
    "negative": TASTE | {"terms": [TERM | {"weight": -1.0}]},
    "zero": TASTE | {"terms": [TERM | {"full": 0.0}]},
    "text": TASTE | {"terms": [TERM | {"full": "1"}]},
    "words": TASTE | {"words": 3},
    "weight": TASTE | {"weight": float("inf")},
    "term": TASTE | {"terms": ["speed"]},
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_file_is_refused(case: str) -> None:
    with pytest.raises(UserError, match="a test is no taste: "):
        read_taste(WRONG[case], "a test")


# Judging policies


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> dict[str, Any]:
    """Two native episodes of the shipped policy, and one in stock robosuite."""
    folder, results = tmp_path_factory.mktemp("evaluations"), {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runners, "usable_cpus", lambda: 1)
        for env, episodes in (("native", 2), ("stock", 1)):
            path = folder / f"{env}.json"
            options = f"--env {env} --episodes {episodes} --json {path}"
            command = f"Lift --taste gentle {options}"
            assert cli.run(main._program("evaluate"), command.split()) == 0
            results[env] = json.loads(path.read_text())
    return results


@pytest.mark.parametrize("env", ["native", "stock"])
def test_an_evaluation_gives_the_penalty(env: str, results: dict[str, Any]) -> None:
    result = results[env]
    penalty = result["taste_penalty"]
    assert result["taste"] == "gentle"
    assert result["success"]["success_held"]["rate"] == 1
    assert 0.1 < penalty["mean"] < 1.5
    assert penalty["low"] <= penalty["mean"] <= penalty["high"]


def test_the_penalty_is_that_of_the_steps() -> None:
    settings = EpisodeSettings(
        "Lift", RobotConfig(), episodes=2, backend="native", taste=HandTilt()
    )
    env = make_env(settings, 2)
    shown: list[Array] = []
    column = env.batch.measure_names.index("hand_tilt")

    def policy(parts: Any) -> torch.Tensor:
        shown.append(env.batch.measures()[:, column])
        return torch.full((2, 7), 0.1)

    episodes = runners.run_settings(env, policy, settings, 2)
    assert len(shown) == 100
    for episode in episodes:
        before = [step[episode.env_id] for step in shown[1:]]
        assert episode.penalty == pytest.approx(np.mean(before), rel=0.02)


class HandTilt:
    """The tilt itself is the penalty."""

    def penalties(self, measures: Array, names: Sequence[str]) -> Array:
        return measures[..., names.index("hand_tilt")]


def test_an_unknown_taste_is_an_error_before_the_episodes(capsys) -> None:
    program = main._program("evaluate")
    assert cli.run(program, ["Lift", "--taste", "gentel"]) == 2
    assert "did you mean 'gentle'" in capsys.readouterr().err
