"""What the README shows of other libraries runs as it stands there."""

import importlib.util
import re
from pathlib import Path

import pytest

README = (Path(__file__).parents[1] / "README.md").read_text()
SECTION = README.split("## Other libraries\n")[1].split("\n## ")[0]
SNIPPETS = re.findall(r"```python\n(.*?)```", SECTION, re.DOTALL)


def snippet(of: str) -> str:
    (found,) = (code for code in SNIPPETS if of in code)
    return found


def test_gymnasium_runs_as_the_readme_says(capsys) -> None:
    scope: dict = {}
    exec(snippet('make_vec("manip/Lift-v0"'), scope)
    assert scope["observation"].shape[0] == 64
    assert scope["env"].reset(seed=0)[0].shape == scope["observation"].shape[1:]
    assert "False" in capsys.readouterr().out


def test_dm_env_runs_as_the_readme_says(capsys) -> None:
    exec(snippet("TaskEnvironment"), {})
    assert capsys.readouterr().out.endswith("1.0 False\n")


@pytest.mark.skipif(
    importlib.util.find_spec("stable_baselines3") is None, reason="see `make peers`"
)
def test_stable_baselines3_runs_as_the_readme_says() -> None:
    exec(snippet("Sb3VecEnv").replace("16_000", "64"), scope := {})
    assert scope["envs"].num_envs == 16


def test_every_snippet_is_run() -> None:
    assert len(SNIPPETS) == 3
