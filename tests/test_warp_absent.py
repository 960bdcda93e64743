"""The engine warp without its packages or a GPU: one clear line, nothing written."""

import sys
from dataclasses import replace
from pathlib import Path

import pytest

from manip.envs import make_batch
from manip.errors import UserError
from manip.programs import benchmark, certify, cli, evaluate
from manip.programs import train as train_program
from manip.sim.warp.library import check_library
from manip.sim.warp.sizes import MEASURED, UNKNOWN, Sizes, check_demand, with_head_room
from manip.training.build import training_envs
from manip.training.placement import learner_device, placement_notes
from manip.training.recipes import recipe


@pytest.fixture
def absent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco_warp", None)
    monkeypatch.setitem(sys.modules, "warp", None)


@pytest.mark.usefixtures("absent")
def test_training_says_which_packages_are_missing(tmp_path, capsys) -> None:
    arguments = f"--task Reach --algo ppo --engine warp --out {tmp_path / 'a'}"
    assert cli.run(train_program.main, arguments.split()) == 2
    error = capsys.readouterr().err
    assert "pip install --no-deps mujoco-warp==3.8.1 warp-lang==1.13.0" in error
    assert "the extra `gpu`" in error
    assert len(error.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("program", "arguments"),
    [
        (evaluate, "Reach --policy expert --engine warp --device cpu --episodes 1"),
        (certify, "Reach --device cpu"),
        (benchmark, "gpu --device cpu --num-envs 2"),
    ],
)
@pytest.mark.usefixtures("absent")
def test_other_programs_say_which_packages_are_missing(
    program, arguments: str, capsys
) -> None:
    assert cli.run(program.main, arguments.split()) == 2
    assert "mujoco-warp==3.8.1" in capsys.readouterr().err


def install(monkeypatch, warp: type) -> None:
    """Make `warp`, and a `mujoco_warp`, importable."""
    monkeypatch.setitem(sys.modules, "warp", warp)
    monkeypatch.setitem(sys.modules, "mujoco_warp", object())


class NoGpu:
    config = type("Config", (), {"quiet": False})

    @staticmethod
    def is_cuda_available() -> bool:
        return False


def test_without_a_gpu_the_error_names_the_other_ways(monkeypatch) -> None:
    install(monkeypatch, NoGpu)
    with pytest.raises(UserError, match=r"needs an NVIDIA GPU.*--device cpu.*native"):
        check_library("cuda")
    check_library("cpu")
    with pytest.raises(UserError, match=r"unknown device 'gpu'.*cpu, cuda"):
        check_library("gpu")


class WithGpu(NoGpu):
    @staticmethod
    def is_cuda_available() -> bool:
        return True


def test_the_learner_needs_a_torch_with_cuda(monkeypatch) -> None:
    install(monkeypatch, WithGpu)
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    config = replace(recipe("Reach", "ppo"), engine="warp")
    with pytest.raises(UserError, match=r"this torch finds no CUDA.*--device cpu"):
        learner_device(config)
    monkeypatch.setattr("torch.cuda.is_available", lambda: True)
    assert learner_device(config).type == "cuda"


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({}, ""),
        ({"observe": "cameras"}, "images are drawn on the host"),
        ({"preferences": Path("clips")}, "clips are compared on the host"),
    ],
)
def test_a_run_says_where_it_learns(changes, reason: str) -> None:
    on_cpu = replace(recipe("Reach", "sac"), engine="warp", device="cpu", **changes)
    assert learner_device(on_cpu).type == "cpu"
    assert [*placement_notes(on_cpu)] == []
    (note,) = placement_notes(replace(on_cpu, device=None))
    assert note.endswith(reason or "gradients: TorchRL's losses")


def test_other_algorithms_learn_on_the_cpu() -> None:
    (note,) = placement_notes(replace(recipe("Reach", "td3"), engine="warp"))
    assert "learner on the CPU: td3 takes no other device" in note


def test_options_of_warp_need_the_engine() -> None:
    for name, value in {"device": "cpu", "njmax": 9, "nconmax": 9}.items():
        config = replace(recipe("Reach", "ppo"), **{name: value})
        with pytest.raises(UserError, match="are options of --engine warp"):
            training_envs(config)
    with pytest.raises(UserError, match="unknown option 'device'"):
        make_batch("Reach", 1, device="cpu")


def test_warp_steps_all_environments_at_once() -> None:
    config = replace(recipe("Reach", "ppo"), engine="warp", num_envs=32, collectors=2)
    with pytest.raises(UserError, match="leave out --collectors"):
        training_envs(config)


def test_demand_beyond_the_sizes_names_the_option_and_the_number() -> None:
    sizes = Sizes(njmax=64, nconmax=16)
    check_demand(sizes, 10, rows=64, contacts=160)
    with pytest.raises(UserError, match=r"needs 65 constraint rows.*--njmax 112"):
        check_demand(sizes, 10, rows=65, contacts=0)
    with pytest.raises(
        UserError, match=r"10 environments need 161 contacts.*--nconmax 32"
    ):
        check_demand(sizes, 10, rows=0, contacts=161)


def test_head_room_is_half_and_a_multiple_of_16() -> None:
    assert [with_head_room(n) for n in (1, 10, 11, 64, 65)] == [16, 16, 16, 96, 112]
    for needed in (*MEASURED.values(), UNKNOWN):
        for number in needed:
            assert with_head_room(number) % 16 == 0
            assert with_head_room(number) >= 1.4 * number
