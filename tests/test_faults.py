"""Non-finite numbers in an environment: named, stored, and no harm to the others."""

from pathlib import Path

import numpy as np
import pytest
from tiny import Tiny

from manip.envs.backends.native_batch import DUMP_FORMAT, MOST_DUMPS, NativeBatch
from manip.envs.task import Task
from manip.envs.time_step import TimeStep
from manip.errors import UserError
from manip.io.tensor_trees import load_tree, save_tree
from manip.programs import cli, replay
from manip.sim.scene import Scene

Array = np.ndarray

N, FAULTY, WHEN = 64, 17, 2
"""Environments; the one that goes wrong; the step in which it does, from 0."""


def turned(m) -> Array:
    """[N] bool: the first joint is turned by 2 rad and more."""
    return m["joint_pos"][:, 0] > 2


class InfiniteObservation(Tiny):
    """An observation that is infinite where an arm is turned."""

    def observe(self, m):
        parts = super().observe(m)
        closing = np.where(turned(m)[:, None], np.inf, parts["closing"])
        return parts | {"closing": closing}


class NanReward(Tiny):
    """A reward that is NaN where an arm is turned."""

    def reward_terms(self, m, reward):
        terms = super().reward_terms(m, reward)
        return {"closing": np.where(turned(m), np.nan, terms["closing"])}


@pytest.fixture(scope="module")
def scene(scene_of) -> Scene:
    return scene_of(Tiny())


def play(batch: NativeBatch, fault: str = "") -> list[TimeStep]:
    """Take five steps; cause a fault of one environment in the third."""
    batch.begin(np.arange(batch.num_envs))
    actions = np.random.default_rng(0).uniform(0.1, 1, (5, batch.num_envs, 7))
    steps = []
    for number, action in enumerate(actions):
        if fault and number == WHEN:
            if fault == "action":
                action[FAULTY, 3] = np.nan
            elif fault == "physics":
                batch.engine.states[FAULTY, batch.scene.physics.nq + 2] = 1e7
            else:
                batch.engine.states[FAULTY, 0] = 2.5
        steps.append(batch.step(action))
        batch.begin(np.flatnonzero(steps[-1].done))
    return steps


CASES = [
    ("physics", Tiny, "physics"),
    ("action", Tiny, "action"),
    ("observation", InfiniteObservation, "observation 'closing'"),
    ("reward", NanReward, "reward term 'closing'"),
]


@pytest.mark.parametrize(("part", "task", "what"), CASES)
def test_one_faulty_environment_of_many_is_named_and_loses_its_episode_only(
    part: str,
    task: type[Task],
    what: str,
    scene: Scene,
    tmp_path: Path,
    capsys,
    monkeypatch,
) -> None:
    batch = NativeBatch(task(), N, scene=scene)
    batch.dump_folder = tmp_path
    healthy = play(NativeBatch(task(), N, scene=scene))
    steps = play(batch, part)
    (fault,) = batch.faults
    assert fault == (task.__name__, what, FAULTY, 0, WHEN + 1)
    others = np.arange(N) != FAULTY
    for time_step, well in zip(steps, healthy, strict=True):
        for name in ("observation", "reward", "success", "terminated", "truncated"):
            values, expected = (getattr(each, name) for each in (time_step, well))
            np.testing.assert_array_equal(values[others], expected[others])
            assert np.isfinite(values).all(), name
    assert steps[WHEN].truncated.tolist() == [i == FAULTY for i in range(N)]
    (dump,) = tmp_path.iterdir()
    assert cli.run(replay.main, [str(dump)]) == 1
    shown = capsys.readouterr().out
    assert str(fault) in shown
    assert f"{task.__name__}: {what} of environment 0 is not finite in step" in shown
    assert "robot0_joint1" in shown


def broken_step(scene: Scene, folder: Path) -> tuple[Path, NativeBatch]:
    """A dump of a NaN action in environment 1 of 3, and the batch before that step."""
    batch = NativeBatch(Tiny(), 3, scene=scene)
    batch.dump_folder = folder
    before = NativeBatch(Tiny(), 3, scene=scene)
    action = np.full((3, 7), 0.4)
    for each in (batch, before):
        each.begin(np.arange(3))
        each.step(action)
    action[1, 0] = np.nan
    batch.step(action)
    (dump,) = folder.iterdir()
    return dump, before


def test_a_dump_holds_the_state_before_the_step(scene: Scene, tmp_path: Path) -> None:
    path, before = broken_step(scene, tmp_path)
    dump, expected = load_tree(path), before.engine.save(np.array([1]))
    again = replay._batch(dump, Tiny())
    np.testing.assert_array_equal(again.engine.states, expected.states)
    np.testing.assert_array_equal(again.engine.save().readings, expected.readings)


@pytest.mark.parametrize(
    "change",
    [
        {"robot": {"arm": "Panda", "dumps": "elsewhere"}},
        {"state": np.zeros(1)},
        {"readings": np.zeros(3)},
        {"action": np.zeros(3)},
        {"reward_weights": {"closing": 1e300}},
        {"fidelity": "fasst"},
        {"fault": {"a": 1}},
    ],
    ids=str,
)
def test_a_dump_that_does_not_fit_is_refused(
    change: dict, scene: Scene, tmp_path: Path, capsys
) -> None:
    path, _ = broken_step(scene, tmp_path)
    save_tree(path, load_tree(path) | change)
    assert cli.run(replay.main, [str(path)]) == 2
    assert capsys.readouterr().err.startswith("manip: error: ")


def test_a_file_that_is_no_dump_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "dump.safetensors"
    assert cli.run(replay.main, [str(path)]) == 2
    save_tree(path, {"format": DUMP_FORMAT - 1})
    assert cli.run(replay.main, [str(path)]) == 2


def test_a_fault_can_end_the_run_and_names_its_dump(scene, tmp_path) -> None:
    batch = NativeBatch(NanReward(), N, scene=scene)
    batch.dump_folder = tmp_path
    batch.stop_at_faults = True
    message = (
        f"NanReward: reward term 'closing' of environment {FAULTY} is not finite in "
        f"step 3 of its episode 0; manip replay {tmp_path}"
    )
    with pytest.raises(UserError, match=message):
        play(batch, "reward")


def test_the_number_of_dumps_is_bounded(scene: Scene, tmp_path: Path) -> None:
    batch = NativeBatch(Tiny(), N, scene=scene)
    batch.dump_folder = tmp_path
    batch.begin(np.arange(N))
    batch.step(np.full((N, 7), np.nan))
    assert len(batch.faults) == N
    assert len(list(tmp_path.iterdir())) == MOST_DUMPS
