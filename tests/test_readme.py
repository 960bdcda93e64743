"""Every Python snippet of the README runs as it is printed there."""

import importlib.util
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
SNIPPETS = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


def snippet(text: str) -> str:
    """The only snippet that contains a text."""
    (code,) = (code for code in SNIPPETS if text in code)
    return code


def test_training_runs(tmp_path: Path) -> None:
    short = "steps=64, eval_episodes=1, num_envs=4, threads=1, horizon=8, seed=0"
    code = snippet("train(config)").replace("seed=0", short)
    exec(code.replace("runs/reach", str(tmp_path)), scope := {})
    assert scope["result"].env_steps >= 64
    assert scope["result"].folder == tmp_path


def test_the_torchrl_environment_runs() -> None:
    exec(snippet("step_and_maybe_reset"), scope := {})
    assert scope["step"]["next", "reward"].shape == (64, 1)


@pytest.mark.slow
def test_a_policy_runs_in_a_robosuite_environment_of_the_user(capsys) -> None:
    shipped = str(ROOT / "assets" / "policies" / "Lift")
    exec(snippet("robosuite.make").replace("runs/demo", shipped), {})
    assert capsys.readouterr().out.count("True") >= 4


def test_gymnasium_runs(capsys) -> None:
    exec(snippet('make_vec("manip/Lift-v0"'), scope := {})
    assert scope["observation"].shape[0] == 64
    assert scope["env"].reset(seed=0)[0].shape == scope["observation"].shape[1:]
    assert "False" in capsys.readouterr().out


def test_dm_env_runs(capsys) -> None:
    exec(snippet("TaskEnvironment"), {})
    assert capsys.readouterr().out.endswith("1.0 False\n")


@pytest.mark.skipif(
    importlib.util.find_spec("stable_baselines3") is None, reason="see `make peers`"
)
def test_stable_baselines3_runs() -> None:
    exec(snippet("Sb3VecEnv").replace("16_000", "64"), scope := {})
    assert scope["envs"].num_envs == 16


def test_no_snippet_is_left_out() -> None:
    assert len(SNIPPETS) == 6
