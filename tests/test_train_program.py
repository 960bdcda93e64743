"""`manip train`: its options, what it prints, and what it refuses before any work."""

import os
import resource
import sys
import types
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from manip.agents.agent import Spaces
from manip.errors import UserError, out_of_memory
from manip.programs import train
from manip.training import memory
from manip.training.config import TrainConfig
from manip.training.memory import check_memory, memory_errors
from manip.training.progress import Progress
from manip.training.recipes import recipe
from manip.training.run_logs import check_wandb
from manip.training.terminal import TerminalProgress


class StoppedError(Exception):
    """Raised in place of a training."""


def config_of(arguments: str, monkeypatch: pytest.MonkeyPatch) -> TrainConfig:
    """The options that a command line trains with."""
    configs = []

    def record(config: TrainConfig, **_: Any) -> None:
        configs.append(config)
        raise StoppedError

    monkeypatch.setattr(train, "train", record)
    with pytest.raises(StoppedError):
        train.main(arguments.split())
    return configs[0]


@pytest.mark.parametrize(
    ("number", "steps"),
    [("1e6", 1_000_000), ("2.5E5", 250_000), ("1e+3", 1000), ("700", 700)],
)
@pytest.mark.parametrize("form", ["--steps {}", "--steps={}"])
def test_whole_numbers_may_have_an_exponent(number, steps, form, monkeypatch) -> None:
    config = config_of(f"--task Reach --out 1e3 {form.format(number)}", monkeypatch)
    assert (config.steps, config.out) == (steps, Path("1e3"))


@pytest.mark.parametrize("number", ["1.5", "1e-3", "1.2345e2", "1e400", "many"])
def test_steps_that_are_no_whole_number_are_refused(number: str) -> None:
    with pytest.raises(UserError, match=f"--steps.*{number}"):
        train.main(["--steps", number])


def test_reward_weights_are_names_and_numbers(monkeypatch) -> None:
    config = config_of("--reward-weights lift=0.6 reach=0.1 --seed 3", monkeypatch)
    assert config == replace(
        recipe("Lift", "sac"), reward_weights=("lift=0.6", "reach=0.1"), seed=3
    )


@pytest.fixture
def wandb(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """An installed package wandb, and no login."""
    monkeypatch.setitem(sys.modules, "wandb", package := types.ModuleType("wandb"))
    package.__spec__ = types.SimpleNamespace()
    for name in ("WANDB_API_KEY", "WANDB_MODE", "WANDB_BASE_URL"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("NETRC", str(tmp_path / "netrc"))


def test_wandb_is_refused_where_it_is_not_installed(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "wandb", None)
    check_wandb(None)
    with pytest.raises(UserError, match="--wandb needs the package wandb: pip install"):
        check_wandb("project")


def test_wandb_is_refused_without_a_login(wandb) -> None:
    with pytest.raises(UserError, match="--wandb needs a login: run `wandb login`"):
        check_wandb("project")


@pytest.mark.parametrize(
    ("name", "value"),
    [("WANDB_API_KEY", "key"), ("WANDB_MODE", "offline"), ("WANDB_MODE", "disabled")],
)
def test_wandb_takes_a_key_or_works_offline(name, value, wandb, monkeypatch) -> None:
    monkeypatch.setenv(name, value)
    check_wandb("project")


def test_wandb_takes_the_key_that_its_login_stored(wandb, tmp_path: Path) -> None:
    netrc = tmp_path / "netrc"
    netrc.write_text("machine api.wandb.ai login user password key\n")
    netrc.chmod(0o600)
    check_wandb("project")
    netrc.write_text("machine")
    with pytest.raises(UserError, match="--wandb needs a login"):
        check_wandb("project")


REPORT = Progress(64, 128, 1.0, 64.0, messages=("runs/[/a][b] · lost",))


def test_messages_are_printed_as_they_are(capsys) -> None:
    with TerminalProgress() as progress:
        progress(REPORT)
    assert capsys.readouterr().err == "runs/[/a][b] · lost\n"


def closed(read: int, write: int) -> Any:
    stream = os.fdopen(write, "w")
    stream.close()
    os.close(read)
    return stream


def without_reader(read: int, write: int) -> Any:
    os.close(read)
    return os.fdopen(write, "w", buffering=1)


def ascii_only(read: int, write: int) -> Any:
    os.close(read)
    return os.fdopen(write, "w", encoding="ascii", buffering=1)


def absent(read: int, write: int) -> Any:
    os.close(read)
    os.close(write)


@pytest.mark.parametrize("stream", [closed, without_reader, ascii_only, absent])
def test_output_that_cannot_be_written_ends_no_run(stream, monkeypatch) -> None:
    monkeypatch.setattr(sys, "stderr", stream(*os.pipe()))
    with TerminalProgress() as progress:
        for _ in range(3):
            progress(REPORT)


def test_errors_of_every_allocator_are_one_line() -> None:
    for allocate in (
        lambda: torch.empty(10**15),
        lambda: np.empty(10**15),
        lambda: bytearray(10**15),
    ):
        with pytest.raises(UserError, match=r"^not enough memory"), memory_errors():
            allocate()
    assert not out_of_memory(RuntimeError("shape mismatch"))
    with pytest.raises(RuntimeError, match="shape"), memory_errors():
        raise RuntimeError("shape mismatch")


def test_a_buffer_that_does_not_fit_is_refused_before_it_is_made(monkeypatch) -> None:
    config = recipe("Lift", "sac")
    large = replace(config, agent=replace(config.agent, buffer_size=20_000_000))
    check_memory(config, Spaces(40, 7))
    monkeypatch.setattr(memory, "available_memory", lambda: 2**60)
    monkeypatch.setattr(resource, "getrlimit", lambda _: (2**32, 2**32))
    with pytest.raises(UserError, match=r"20,000,000 steps needs at least 6.5 GiB.*"):
        check_memory(large, Spaces(40, 7))
    check_memory(recipe("Lift", "ppo"), Spaces(40, 7))


def test_a_buffer_larger_than_the_memory_is_refused(monkeypatch) -> None:
    config = recipe("Lift", "sac")
    large = replace(config, agent=replace(config.agent, buffer_size=20_000_000))
    monkeypatch.setattr(memory, "_meminfo", lambda *_: 2**32)
    with pytest.raises(UserError, match=r"and 4.0 GiB can be allocated"):
        check_memory(replace(large, steps=100_000), Spaces(40, 7))


def test_memory_that_a_short_run_never_fills_is_not_needed(monkeypatch) -> None:
    config = recipe("Lift", "sac")
    large = replace(config, agent=replace(config.agent, buffer_size=20_000_000))
    monkeypatch.setattr(memory, "available_memory", lambda: 2**30)
    check_memory(replace(large, steps=100_000), Spaces(40, 7))
    with pytest.raises(UserError, match=r"and 1.0 GiB can be allocated: .*buffer-size"):
        check_memory(replace(large, steps=10**8), Spaces(40, 7))
