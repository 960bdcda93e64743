"""An algorithm of one's own: the documented example works, mistakes are one line."""

import json
import re
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
import torch
from toy import Points, mean_return
from training_runs import assert_equal_runs

from manip.agents.agent import Agent, AgentConfig, Spaces
from manip.agents.policy import load_policy
from manip.agents.registry import algorithm_names, load_algorithm
from manip.errors import UserError
from manip.programs import cli, main
from manip.training.collector import Rollout
from manip.training.config import recorded

ROOT = Path(__file__).parents[1]
PAGE, FOLDER = ROOT / "docs/own-algorithm.md", ROOT / "docs/own_algorithm"


@pytest.fixture(autouse=True)
def _in_the_folder(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """As a user does: working where the module lies, without installing it."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.chdir(FOLDER)
    yield
    sys.modules.pop("advantage", None)


def test_the_page_shows_the_files() -> None:
    page = PAGE.read_text()
    blocks = re.findall("```python\n(.*?)```", page, re.DOTALL)
    assert "".join(blocks).split() == (FOLDER / "advantage.py").read_text().split()
    assert (FOLDER / "pyproject.toml").read_text() in page


def test_it_learns_the_toy_problem() -> None:
    algorithm = load_algorithm("advantage:AWR")
    options = algorithm.Config(learning_rate=3e-3, rollout_length=20, beta=0.1)
    torch.manual_seed(0)
    agent = algorithm(options, Spaces(1, 1))
    rollout = Rollout(Points([20] * 16))
    assert mean_return(agent) < 15
    for _ in range(12):
        agent.update(rollout.collect(agent.policy(), 20).batch)
    assert mean_return(agent) > 15.5


SIZE = "--num-envs 4 --threads 1 --eval-every 64 --eval-episodes 1 --horizon 10"
OPTIONS = "--agent.rollout-length 8 --agent.beta 0.5 --agent.actor-hidden 16"


def start(program: str, *arguments: object) -> None:
    assert cli.run(main._program(program), list(map(str, arguments))) == 0


def train(out: Path, steps: int, *more: object) -> None:
    options = f"--task Reach --algo advantage:AWR {SIZE} {OPTIONS}".split()
    options = ["--resume"] if more else options
    start("train", *options, "--steps", steps, "--out", out)


def test_it_is_trained_resumed_bit_for_bit_and_evaluated(tmp_path: Path) -> None:
    whole, broken, result = (tmp_path / name for name in ("a", "b", "eval.json"))
    train(whole, 128)
    train(broken, 64)
    train(broken, 128, "resume")
    assert_equal_runs(whole, broken)
    config = recorded(whole)
    assert (config.algo, config.agent.beta) == ("advantage:AWR", 0.5)
    assert load_policy(whole).card.algo == "advantage:AWR"
    start("evaluate", whole, "--env", "native", "--episodes", 2, "--json", result)
    assert json.loads(result.read_text())


def test_its_options_are_flags_with_ranges(capsys) -> None:
    with pytest.raises(SystemExit):
        cli.run(main._program("train"), ["--algo", "advantage:AWR", "--help"])
    assert "--agent.beta FLOAT" in capsys.readouterr().out
    line = ["--algo", "advantage:AWR", "--agent.beta", "0"]
    assert cli.run(main._program("train"), line) == 2
    assert "beta must be at least 1e-09, not 0" in capsys.readouterr().err


def test_an_entry_point_gives_it_a_name(tmp_path: Path, monkeypatch) -> None:
    project = tomllib.loads((FOLDER / "pyproject.toml").read_text())["project"]
    info = tmp_path / f"{project['name']}-{project['version']}.dist-info"
    info.mkdir()
    points = project["entry-points"]["manip.algorithms"]
    lines = [f"{name} = {where}" for name, where in points.items()]
    (info / "entry_points.txt").write_text("\n".join(["[manip.algorithms]", *lines]))
    assert "awr" not in algorithm_names()
    monkeypatch.syspath_prepend(tmp_path)
    assert "awr" in algorithm_names()
    assert load_algorithm("awr").name == "awr"


def test_an_algorithm_that_lies_in_its_run_folder_is_not_imported(tmp_path) -> None:
    run = tmp_path / "runs" / "demo"
    run.mkdir(parents=True)
    (run / "evil.py").write_text("raise SystemExit('imported')")
    for name in ("evil:AWR", "runs.demo.evil:AWR"):
        (run / "config.yaml").write_text(f"algo: {name}\n")
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(tmp_path if "." in name else run)
            patch.setattr(sys, "path", list(sys.path))
            with pytest.raises(UserError, match="evil"):
                recorded(run)
    assert "evil" not in sys.modules


@dataclass(frozen=True)
class Options(AgentConfig):
    """Options of the wrong algorithms below."""


class Unfinished(Agent):
    """An algorithm without methods."""

    name = "unfinished"
    Config = Options


class NoConfig(Unfinished):
    Config = dict


NoConfig.__abstractmethods__ = frozenset()


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("nowhere:AWR", "cannot import algorithm 'nowhere:AWR': ModuleNotFoundError"),
        ("advantage:ARW", "cannot import algorithm 'advantage:ARW': AttributeError"),
        ("advantage:AWRLoss", "must be a subclass of manip.agents.agent.Agent"),
        (f"{__name__}:Unfinished", "does not define __init__, modules, optimisers"),
        (f"{__name__}:NoConfig", "Config must be a frozen dataclass and a subclass"),
        ("ppoo", "unknown algorithm 'ppoo': did you mean 'ppo'"),
    ],
)
def test_what_is_no_algorithm_is_refused(name: str, message: str) -> None:
    with pytest.raises(UserError, match=message) as error:
        load_algorithm(name)
    assert "\n" not in str(error.value)
