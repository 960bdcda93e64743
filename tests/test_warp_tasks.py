"""Tasks, training and certificates on MuJoCo Warp's CPU device."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from manip.envs import make_batch
from manip.envs.adapters.torchrl import TaskEnv
from manip.envs.task_batch import TaskBatch
from manip.envs.task_registry import load_task
from manip.programs import benchmark, certify, cli
from manip.robot_config import RobotConfig
from manip.training import build
from manip.training.contact_check import contact_differences
from manip.training.randomisation import load_randomisation
from manip.training.recipes import recipe
from manip.training.run import train
from manip.training.run_logs import read_metrics

pytestmark = pytest.mark.slow

INSTALL = "the extra `gpu`: pip install --no-deps mujoco-warp==3.8.1 warp-lang==1.13.0"
pytest.importorskip("warp", reason=INSTALL)
pytest.importorskip("mujoco_warp", reason=INSTALL)

Array = np.ndarray

NUM_ENVS = 8


def succeeded(batch: TaskBatch) -> Array:
    """[N] bool: success in the last ten steps of the expert's episodes."""
    batch.begin(np.arange(batch.num_envs))
    flags = [batch.step(batch.expert()).success for _ in range(batch.horizon)]
    return np.all(flags[-10:], axis=0)


@pytest.mark.parametrize(
    ("name", "different"),
    [
        *(("Reach", 0), ("Lift", 0), ("Stack", 0), ("Push", 1), ("PickGoal", 1)),
        *(("Door", 1), ("PickPlaceCan", 1), ("NutAssemblySquare", 1), ("Wipe", 1)),
        ("ToolHang", 1),
    ],
)
def test_experts_succeed_as_on_c(name: str, different: int) -> None:
    native, warp = (
        succeeded(make_batch(name, NUM_ENVS, backend=backend, **options))
        for backend, options in (("native", {}), ("warp", {"device": "cpu"}))
    )
    assert native.sum() >= NUM_ENVS - 1
    assert (native != warp).sum() <= different


@pytest.mark.parametrize(
    "name", ["Lift", "Stack", "NutAssemblySquare", "Wipe", "ToolHang"]
)
def test_contacts_of_boxes_are_those_of_c(name: str) -> None:
    differences = contact_differences(load_task(name), RobotConfig(), "cpu")
    boxes = differences["box-box"]
    assert boxes.pairs > 100
    assert (boxes.missed, boxes.ghosts) == ([], [])
    assert boxes.depth < 1e-6


def test_a_run_is_resumed_and_says_that_it_differs(tmp_path) -> None:
    config = replace(
        recipe("Reach", "ppo"),
        engine="warp", device="cpu", num_envs=16, steps=512, out=tmp_path / "run",
        eval_every=512, eval_episodes=2, curve_episodes=0,
    )  # fmt: skip
    assert train(config).env_steps == 512
    more = replace(config, steps=1024, resume=True)
    with pytest.warns(UserWarning, match="warp: the run continues.*not bit for bit"):
        result = train(more)
    assert result.env_steps == 1024


@pytest.mark.parametrize("name", ["Lift", "Reach", "Stack"])
def test_a_task_on_the_device_gives_the_same_steps(name: str) -> None:
    options = {"backend": "warp", "device": "cpu", "horizon": 5, "stagger": True}
    host, device = (
        TaskEnv(make_batch(name, 4, tensors=tensors, restart_fraction=0.5, **options))
        for tensors in (False, True)
    )
    assert (host.batch.gives_tensors, device.batch.gives_tensors) == (False, True)
    states, draw = [env.reset() for env in (host, device)], torch.manual_seed(0)
    for _ in range(12):
        action = torch.rand(4, 7, generator=draw) * 2 - 1
        steps = []
        for number, env in enumerate((host, device)):
            state = states[number].set("action", action)
            step, states[number] = env.step_and_maybe_reset(state)
            steps.append(step)
        torch.testing.assert_close(*steps)
    saved = [env.batch.save_state()["states"] for env in (host, device)]
    np.testing.assert_array_equal(*saved)


def test_what_needs_the_host_runs_there() -> None:
    options = {"backend": "warp", "device": "cpu", "tensors": True}
    assert not make_batch("Push", 1, **options).gives_tensors
    perturbations = load_randomisation("standard")
    batch = make_batch("Lift", 1, perturbations=perturbations, **options)
    assert not batch.gives_tensors


def test_a_run_with_its_task_on_the_device(tmp_path, monkeypatch) -> None:
    config = replace(
        recipe("Reach", "ppo"),
        engine="warp", device="cpu", num_envs=16, steps=768, out=tmp_path / "run",
        eval_every=256, eval_episodes=2, curve_episodes=0, gradients="torchrl",
    )  # fmt: skip
    monkeypatch.setattr(build, "learns_on_gpu", lambda _: True)
    assert train(config).env_steps == 768
    monkeypatch.undo()
    assert train(replace(config, out=tmp_path / "host")).env_steps == 768
    rows, expected = (
        read_metrics(tmp_path / run / "metrics.csv") for run in ("run", "host")
    )
    for row, other in zip(rows, expected, strict=True):
        for key in ("train/return", "eval/return", "learn/loss_critic"):
            if row.get(key):
                assert float(row[key]) == pytest.approx(float(other[key]), rel=1e-2)


def test_perturbed_models_differ_between_environments() -> None:
    options = {"perturbations": load_randomisation("standard"), "seed": 3}
    native, warp = (
        make_batch("Lift", 3, backend=backend, **options, **more)
        for backend, more in (("native", {}), ("warp", {"device": "cpu"}))
    )
    for batch in (native, warp):
        batch.begin(np.arange(3))
    for _ in range(5):
        for batch in (native, warp):
            batch.step(np.full((3, 7), 0.3))
    a, b = native.read(), warp.read()
    np.testing.assert_allclose(b["joint_pos"], a["joint_pos"], atol=1e-4)
    np.testing.assert_allclose(b["cube_pos"], a["cube_pos"], atol=1e-4)
    model = warp.engine.on_device.model
    assert model.geom_friction.shape[0] == 3
    assert np.ptp(model.geom_friction.numpy()[:, 0, 0]) > 0


def test_the_benchmark_measures_speed_and_memory(capsys) -> None:
    options = "gpu --device cpu --task Reach --fidelity fast --num-envs 2 --rounds 1"
    assert cli.run(benchmark.main, options.split()) == 0
    shown = capsys.readouterr().out
    candidates = ("physics", "engine", "task", "task on the device")
    for text in (*(f"{name}, 2 envs" for name in candidates), "bytes per env"):
        assert text in shown


def test_reach_is_certified(capsys) -> None:
    options = ["Reach", "--device", "cpu", "--episodes", "4", "--stock-episodes", "1"]
    assert cli.run(certify.main, options) == 0
    shown = capsys.readouterr().out
    assert "warp: train on it" in shown
    assert "quote results from: stock robosuite, or the native engine" in shown
