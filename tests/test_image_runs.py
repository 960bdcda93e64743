"""Runs whose actor sees cameras: end to end, resumed, from a teacher, refused."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from training_runs import assert_equal_runs, new_trainer, stop_after

from manip.agents.networks import Actor
from manip.agents.policy import Policy, load_policy
from manip.agents.policy_card import PolicyCard
from manip.cameras import CameraConfig
from manip.envs.make_batch import Backend
from manip.errors import UserError
from manip.evaluation.runners import EpisodeSettings, evaluate_policy
from manip.training.build import (
    build_agent,
    evaluation_env,
    policy_of,
    training_envs,
)
from manip.training.config import TrainConfig, from_dict
from manip.training.inputs import spaces_of
from manip.training.memory import check_memory
from manip.training.state_check import check_like

TASK = "tiny:Tiny"
"""Its episodes last 8 control steps."""


def teacher_in(folder: Path, **changes: Any) -> Policy:
    """Save a policy with random weights that sees Tiny's state."""
    torch.manual_seed(1)
    card = PolicyCard(
        task=TASK,
        robot="Panda",
        algo="sac",
        controller="OSC_POSE",
        control_freq=20,
        action_dim=7,
        observation=[
            {
                "name": name,
                "shape": [width],
                "dtype": "float32",
                "role": "proprioception",
            }
            for name, width in (("closing", 1), ("joint_pos", 7))
        ],
        hidden=[16],
        squash=True,
        normalise=False,
        env_steps=0,
        seed=0,
        versions={},
    )
    policy = Policy(replace(card, **changes), Actor(8, 7, [16], True, False))
    policy.save(folder)
    return policy


def options(folder: Path, **changes: Any) -> TrainConfig:
    agent = {
        "rollout_length": 4,
        "batch_size": 16,
        "buffer_size": 48,
        "actor_hidden": [16],
        "image_channels": [4, 8],
        "image_features": 8,
        "image_shift": 1,
    }
    values = {
        "task": TASK,
        "algo": "bc",
        "observe": "cameras",
        "image_size": 16,
        "frames": 2,
        "teacher": str(folder / "teacher"),
        "out": str(folder / "run"),
        "steps": 48,
        "num_envs": 4,
        "threads": 2,
        "cool_down": 0.5,
        "eval_every": 32,
        "eval_episodes": 1,
        "agent": agent,
    }
    return from_dict(values | changes)


def state_options(folder: Path, **changes: Any) -> TrainConfig:
    return options(
        folder, **{"observe": "state", "image_size": 32, "frames": 1} | changes
    )


@pytest.mark.slow
def test_a_run_from_cameras_resumes_bit_for_bit_and_its_policy_is_usable(
    tmp_path: Path,
) -> None:
    teacher = teacher_in(tmp_path / "teacher")
    config = options(tmp_path, looks=0.5)
    whole = new_trainer(config)
    assert whole.run()
    assert whole.state.learned.keys() == {"loss_actor", "loss_prediction"}
    again = replace(config, out=tmp_path / "again")
    stopped = new_trainer(again)
    stop_after(stopped, 2)
    assert not stopped.run()
    assert new_trainer(replace(again, resume=True)).run()
    assert_equal_runs(config.folder, again.folder)
    card = load_policy(config.folder).card
    assert card.cameras == CameraConfig(("robot0_eye_in_hand",), 16, "exact", 2)
    assert card.observation_spec.names == ("joint_pos", "robot0_eye_in_hand_image")
    assert card.image_quality == "lean"
    next(teacher.actor.parameters()).data += 1.0
    teacher.save(tmp_path / "teacher")
    with pytest.raises(UserError, match="other weights than when"):
        new_trainer(replace(again, resume=True)).run()


def test_the_best_policy_is_chosen_by_images_as_in_training(tmp_path: Path) -> None:
    env = evaluation_env(options(tmp_path, looks=1.0))
    env.reset()
    assert env.batch.cameras.quality == "lean"
    assert env.batch._looks.seeds.all()  # without looks they are 0


def test_looks_are_saved_as_numbers_that_a_checkpoint_may_hold(tmp_path: Path) -> None:
    teacher_in(tmp_path / "teacher")
    (env,) = training_envs(options(tmp_path, looks=1.0))
    env.reset()
    state = env.batch.save_state()
    assert state["looks"].all()
    check_like(state, state, "state")


def test_a_teacher_that_sees_cameras_is_refused(tmp_path: Path) -> None:
    config = from_dict(
        {"task": "Lift", "algo": "bc", "observe": "cameras", "teacher": "Lift-cameras"}
    )
    with pytest.raises(UserError, match="sees cameras: a teacher must see"):
        training_envs(config)


def test_a_teacher_labels_every_state_with_its_own_action(tmp_path: Path) -> None:
    teacher = teacher_in(tmp_path / "teacher")
    (env,) = training_envs(state_options(tmp_path))
    state = env.reset()
    for _ in range(3):
        expected = teacher(env.parts(state))
        assert torch.equal(state["expert_action"], expected)
        state["action"] = -expected
        _, state = env.step_and_maybe_reset(state)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"teacher": "no such folder"}, "holds no policy"),
        ({"algo": "sac", "agent": {}}, "sac imitates no --teacher"),
        ({"robot": "Jaco"}, "trained with robot Panda, not Jaco"),
        ({"task": "Lift", "robot": "Jaco"}, "trained with robot Panda, not Jaco"),
        ({"control_freq": 10}, "trained with control_freq 20, not 10"),
        ({"task": "Lift"}, "on another observation .* closing is missing"),
    ],
)
def test_a_teacher_that_does_not_fit_is_refused(changes, message, tmp_path) -> None:
    teacher_in(tmp_path / "teacher")
    with pytest.raises(UserError, match=message):
        training_envs(state_options(tmp_path, **changes))


def test_a_teacher_of_another_action_space_is_imitated_in_it(tmp_path: Path) -> None:
    teacher_in(tmp_path / "teacher", controller="JOINT_POSITION")
    config = state_options(tmp_path, controller="JOINT_POSITION")
    assert training_envs(config)
    with pytest.raises(UserError, match=r"JOINT_POSITION: .*trained policy by --teach"):
        training_envs(replace(config, teacher=None))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"cameras": []}, "needs one camera or more: set --cameras"),
        ({"cameras": ["wrist"]}, "camera 'wrist'"),
        ({"algo": "td3", "agent": {}}, "td3 does not learn from cameras: .* bc"),
    ],
)
def test_cameras_that_a_run_cannot_see_are_refused(changes, message, tmp_path) -> None:
    with pytest.raises(UserError, match=message):
        training_envs(options(tmp_path, **{"teacher": None} | changes))


@pytest.mark.parametrize(
    ("changes", "option"),
    [
        ({"cameras": ["agentview"]}, "cameras"),
        ({"parts": ["joint_pos"]}, "parts"),
        ({"image_size": 64}, "image-size"),
        ({"looks": 0.5}, "looks"),
    ],
)
def test_options_of_images_need_a_policy_that_sees_some(
    changes: dict[str, Any], option: str, tmp_path: Path
) -> None:
    with pytest.raises(UserError, match=f"--{option} has no effect .* sees the state"):
        training_envs(state_options(tmp_path, teacher=None, **changes))


def test_images_count_in_the_memory_that_a_run_needs(tmp_path: Path) -> None:
    agent = {"buffer_size": 10**6}
    config = options(tmp_path, teacher=None, steps=10**6, image_size=512, agent=agent)
    spaces = spaces_of(config, evaluation_env(config))
    check_memory(config, replace(spaces, actor=None))
    with pytest.raises(UserError, match=r"1,000,000 steps needs at least 1,46\d"):
        check_memory(config, spaces)


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["native", "stock"])
def test_a_policy_is_evaluated_with_the_images_of_either_backend(
    backend: Backend, tmp_path: Path
) -> None:
    config = options(tmp_path, teacher=None, eval_episodes=1)
    env = evaluation_env(config)
    policy = policy_of(build_agent(config, env), config, env, 0)
    settings = EpisodeSettings(
        TASK,
        config.robot_config,
        policy.card.observation,
        policy.card.cameras,
        episodes=1,
        backend=backend,
    )
    (episode,) = evaluate_policy(policy, settings)
    assert 0 < episode.steps <= 8
