"""Recipes and options of runs."""

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pytest
import yaml
from training_runs import tiny

from manip.agents.registry import algorithm_names, load_algorithm
from manip.agents.sac import SACConfig
from manip.envs.task_registry import load_task, task_names
from manip.errors import UserError
from manip.programs import train
from manip.training.build import build_agent, evaluation_env, training_envs
from manip.training.config import TrainConfig, from_dict, to_dict
from manip.training.recipes import (
    recipe,
    recipe_choice,
    recipe_names,
    recipes,
    with_labels,
)

ENGINES = ("native", "warp")


def test_every_recipe_loads_for_the_task_and_algorithm_it_is_named_after() -> None:
    for name in recipe_names():
        task, algo, observe = recipe_choice(name)
        names = {known.lower(): known for known in task_names()}
        config = recipe(names.get(task, task), algo, observe=observe)
        assert config != recipe("no recipe", algo, observe=observe), name
        assert isinstance(config.agent, load_algorithm(algo).Config)
        assert load_task(config.task).name.lower() == task
        assert config.eval_every <= config.steps


def test_a_recipe_may_have_other_options_for_some_arms() -> None:
    panda, jaco = (recipe("Lift", "bc", robot) for robot in ("Panda", "Jaco"))
    assert (panda.robot, jaco.robot) == ("Panda", "Jaco")
    assert panda == recipe("Lift", "bc")
    assert jaco.agent.noise < panda.agent.noise
    assert recipes("Jaco")["lift-bc"] == jaco
    assert train._defaults(["--algo", "bc", "--robot", "Jaco"]) == jaco


def test_options_of_the_algorithm_for_an_arm_leave_its_others_alone() -> None:
    panda, xarm = (recipe("Lift", "sac", robot).agent for robot in ("Panda", "XArm7"))
    changed = {"gamma": 0.97, "gripper_bursts": 0.04}
    assert xarm == replace(panda, **changed)
    assert panda.gamma != xarm.gamma
    assert panda.tau != SACConfig().tau


@pytest.mark.parametrize("algo", algorithm_names())
def test_options_survive_yaml(algo: str, tmp_path: Path) -> None:
    options = fields(load_algorithm(algo).Config)
    widths = next(o.name for o in options if o.name.endswith("hidden"))
    config = tiny(algo, tmp_path / "run", seed=3, agent={widths: [8, 8]})
    assert from_dict(yaml.safe_load(yaml.safe_dump(to_dict(config)))) == config


def test_a_run_folder_is_named_after_what_is_trained() -> None:
    config = from_dict({"task": "my.tasks:Stack", "algo": "ppo", "seed": 4})
    assert config.folder == Path("runs/my.tasks.Stack-ppo-4")
    assert replace(config, out=Path("here")).folder == Path("here")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"stepz": 1}, "unknown .*'stepz': did you mean 'steps'.*num_envs"),
        ({"agent": {"gama": 1}}, "unknown SACConfig .*'gama': did you mean 'gamma'"),
        ({"algo": "ppo", "agent": {"tau": 1}}, "unknown PPOConfig option.*clip"),
        ({"algo": "ddqn"}, "unknown algorithm 'ddqn': did you mean 'dqn'.*sac"),
        ({"agent": "fast"}, "must be a mapping, not 'fast'"),
        ({"agent": 3}, "must be a mapping, not 3"),
        ({"steps": 0}, "steps must be at least 1, not 0"),
        ({"eval_every": -1}, "eval_every must be at least 1, not -1"),
        ({"num_envs": "four"}, "num_envs must be a whole number, not 'four'"),
        ({"agent": {"batch_size": 0}}, "batch_size must be at least 1, not 0"),
        ({"seed": -1}, "seed must be at least 0, not -1"),
        ({"restart_fraction": 1.5}, "restart_fraction must be from 0 to 1, not 1.5"),
        ({"cool_down": -1}, "cool_down must be from 0 to 1, not -1"),
        ({"algo": "ppo", "agent": {"clip": 1.5}}, "clip must be from 0 to 1, not 1.5"),
        ({"algo": "ppo-kl", "agent": {"beta": 0}}, "beta must be at least 1e-09"),
    ],
)
def test_wrong_options_are_refused(values: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError, match=message):
        from_dict(values)


# action_scale


def test_a_recipes_action_scale_is_left_out_with_another_controller() -> None:
    own, other = (recipe("Lift", "sac", controller=c) for c in (None, "JOINT_POSITION"))
    assert len(own.agent.action_scale) == 7
    assert other.agent.action_scale == ()
    assert other.controller == "JOINT_POSITION"
    assert replace(other, controller="OSC_POSE", agent=own.agent) == own


def test_leaving_out_a_recipes_action_scale_is_reported(capsys) -> None:
    train._defaults(["--task", "Lift", "--controller", "OSC_POSITION"])
    message = "manip: the recipe's action_scale is not used with OSC_POSITION\n"
    assert capsys.readouterr().err == message
    train._defaults(["--task", "Lift", "--controller", "OSC_POSE"])
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("controller", ["OSC_POSE", "OSC_POSITION", "JOINT_POSITION"])
def test_a_given_action_scale_fits_the_controller_or_is_refused(
    controller: str, tmp_path: Path
) -> None:
    dims = {"OSC_POSE": 7, "OSC_POSITION": 4, "JOINT_POSITION": 8}
    config = tiny("sac", tmp_path / "run", controller=controller, eval_episodes=1)
    env = evaluation_env(config)
    for size in (3, dims[controller]):
        agent = replace(config.agent, action_scale=(0.5,) * size)
        changed = replace(config, agent=agent)
        if size == dims[controller]:
            assert build_agent(changed, env).actor.action_scale.tolist() == [0.5] * size
        else:
            with pytest.raises(UserError, match=f"has 3 numbers, but {controller}"):
                build_agent(changed, env)


def test_options_belong_to_their_algorithm() -> None:
    config = recipe("Lift", "sac")
    with pytest.raises(UserError, match="options of algorithm 'ppo', PPOConfig, not"):
        replace(config, algo="ppo")


def test_a_rollout_must_fit_the_replay_buffer(tmp_path: Path) -> None:
    config = tiny("sac", tmp_path, agent={"buffer_size": 10, "rollout_length": 8})
    with pytest.raises(UserError, match=r"10 is smaller than a rollout of 4 env.* x 8"):
        training_envs(config)


def test_options_for_labels_have_the_types_of_options_and_fit_the_controller() -> None:
    scales = [
        with_labels(recipe("Lift", "pebble", controller=c), Path("labels")).agent
        for c in ("OSC_POSE", "JOINT_POSITION")
    ]
    assert [len(agent.action_scale) for agent in scales] == [7, 0]
    assert all(type(agent.action_scale) is tuple for agent in scales)


def test_options_for_labels_may_be_of_a_task() -> None:
    lift, push = (with_labels(recipe(t, "ppo-kl"), Path("p")) for t in ("Lift", "Push"))
    assert push.labels == replace(lift.labels, clip_steps=push.labels.clip_steps)
    assert push.labels.clip_steps > lift.labels.clip_steps
    assert push.horizon == 100
    assert push.agent.target_kl == lift.agent.target_kl


def updates(config: TrainConfig) -> float:
    rollout = config.num_envs * config.agent.rollout_length
    return config.steps * getattr(config.agent, "updates_per_step", 1 / rollout)


@pytest.mark.parametrize("algo", ["ppo", "sac"])
def test_on_a_gpu_a_recipe_has_more_environments_and_as_many_updates(algo) -> None:
    words = ["--task", "Lift", "--algo", algo]
    usual, on_gpu = (train.config_of([*words, "--engine", e]) for e in ENGINES)
    assert (on_gpu.num_envs, usual.num_envs < 4096) == (4096, True)
    assert updates(on_gpu) == pytest.approx(updates(usual))
    assert on_gpu.steps / on_gpu.eval_every == usual.steps / usual.eval_every
    few = train.config_of([*words, "--engine", "warp", "--num-envs", "64"])
    assert few == replace(on_gpu, num_envs=64)
    cpu = train.config_of([*words, "--engine", "warp", "--device", "cpu"])
    assert replace(cpu, engine="native", device=None) == usual


def test_on_a_gpu_other_algorithms_keep_their_recipes() -> None:
    words = ["--task", "Reach", "--algo", "td3"]
    usual, on_gpu = (train.config_of([*words, "--engine", e]) for e in ENGINES)
    assert on_gpu == replace(usual, engine="warp")
