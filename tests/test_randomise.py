"""Domain randomisation of training runs, and the files of suites and randomisations."""

from dataclasses import replace
from pathlib import Path

import pytest
from training_runs import (
    assert_equal_runs,
    finished,
    new_trainer,
    stop_after,
    tiny,
)

from manip.agents.policy import load_policy
from manip.errors import UserError
from manip.evaluation.stress_suite import load_suite, suite_names
from manip.training.randomisation import load_randomisation, randomisation_names

RANDOMISED = """
- {quantity: joint_damping, uniform: [0, 5]}
- {quantity: action_delay, choice: [0, 1, 2], per: step}
- {quantity: object_position, normal: 0.01, per: step}
- {quantity: observation_delay, choice: [0, 2]}
"""


@pytest.mark.slow
def test_a_randomised_run_resumes_bit_for_bit(tmp_path: Path) -> None:
    listed = tmp_path / "list.yaml"
    listed.write_text(RANDOMISED)
    whole, stopped = (
        tiny("sac", tmp_path / name / "run", randomise=str(listed)) for name in "ab"
    )
    assert new_trainer(whole).run()
    trainer = new_trainer(stopped)
    stop_after(trainer, 9)
    assert not trainer.run()
    assert new_trainer(replace(stopped, resume=True)).run()
    assert_equal_runs(whole.folder, stopped.folder)
    card = load_policy(whole.folder).card
    given = [each.to_dict() for each in load_randomisation(str(listed))]
    assert card.randomised == given
    assert load_policy(finished("sac").folder).card.randomised == []


def test_the_shipped_files_are_valid() -> None:
    assert "standard" in suite_names()
    assert "standard" in randomisation_names()
    for name in suite_names():
        assert all(len(stress.levels) == 3 for stress in load_suite(name).values())
    for name in randomisation_names():
        assert load_randomisation(name)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a: {levels: [1]}", "either a quantity or looks"),
        ("a: {quantity: friction, levels: []}", "one number or more"),
        ("a: {quantity: friction, levels: [-1]}", "from 0.01 to 100"),
        ("a: {looks: lights, levels: [2]}", "from 0 to 1"),
        ("a: {looks: light, levels: [1]}", "did you mean 'lights'"),
        ("a: {quantity: frictions, levels: [1]}", "did you mean 'friction'"),
        ("[]", "must map names"),
    ],
)
def test_impossible_suites_are_refused(text: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "suite.yaml"
    path.write_text(text)
    with pytest.raises(UserError, match=words):
        load_suite(str(path))


def test_what_does_not_exist_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="did you mean 'standard'"):
        load_suite("standart")
    with pytest.raises(UserError, match="did you mean 'standard'"):
        load_randomisation("standart")
    with pytest.raises(UserError, match="there is no file"):
        load_randomisation(str(tmp_path / "none.yaml"))
    assert load_randomisation("") == ()
