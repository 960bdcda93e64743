"""Tasks that take tensors: torch computes what numpy does, on any device."""

from collections.abc import Iterator, Mapping

import numpy as np
import pytest
import torch
from conftest import SceneOf
from second_batch import SecondBatch, on
from second_device import CPU, SECOND, seeded_generator

from manip.agents import on_policy
from manip.agents.agent import Spaces
from manip.agents.ppo import PPO, PPOConfig
from manip.arrays import on_host
from manip.envs.adapters.torchrl import TaskEnv
from manip.envs.backends.native_batch import NativeBatch
from manip.envs.task import Measures, Task
from manip.envs.task_outputs import TaskOutputs, evaluate
from manip.envs.task_registry import load_task, task_names
from manip.envs.time_step import TimeStep
from manip.observation import vector_spec
from manip.rewards.compose import weighted_sum
from manip.sim.scene import Scene
from manip.training.collector import Rollout
from manip.training.experience import Experience

Array = np.ndarray

ABLE = ("Lift", "Reach", "Stack")


def test_these_tasks_take_tensors() -> None:
    able = [name for name in task_names() if load_task(name).takes_tensors]
    assert sorted(able) == [*ABLE]


def readings(task: Task, scene_of: SceneOf) -> Iterator[Measures]:
    """Readings of the expert's episodes, from their start to success."""
    scene = scene_of(task, fidelity="fast")
    batch = NativeBatch(task, 6, scene=scene, threads=1)
    batch.begin(np.arange(6))
    for step in range(61):
        if step % 20 == 0:
            yield {name: values.copy() for name, values in batch.read().items()}
        batch.step(batch.expert())


def named(outputs: TaskOutputs) -> dict[str, Mapping[str, Array]]:
    flags = {"success": outputs.success, "failure": outputs.failure}
    return outputs._asdict() | flags_of(flags)


def flags_of(flags: Mapping[str, Array]) -> dict[str, Mapping[str, Array]]:
    return {name: {name: values} for name, values in flags.items()}


@pytest.mark.parametrize(
    ("name", "reward"),
    [
        *(("Lift", "shaped"), ("Reach", "shaped")),
        pytest.param("Stack", "shaped", marks=pytest.mark.slow),
        *(pytest.param(name, "stock", marks=pytest.mark.slow) for name in ABLE),
    ],
)
def test_torch_computes_what_numpy_does(name: str, reward: str, scene_of) -> None:
    task, reached = load_task(name), []
    for read in readings(task, scene_of):
        expected = evaluate(task, task.measure(read), reward)
        reached.append(expected.success)
        spec = vector_spec(expected.parts, task.proprioception)
        for device in (CPU, SECOND):
            outputs = evaluate(task, task.measure(on(device, read)), reward)
            for kind, values in named(outputs).items():
                for key, tensor in values.items():
                    assert tensor.device == device, (kind, key)
                    other = named(expected)[kind][key]
                    np.testing.assert_allclose(on_host(tensor), other, 1e-12, 1e-13)
            joined = spec.join(outputs.parts)
            assert joined.dtype == torch.float32
            np.testing.assert_array_equal(
                np.float32(on_host(joined)), spec.join(expected.parts)
            )
            paid = weighted_sum(outputs.terms, task.weights[reward])
            assert paid.device == device
    assert np.any(reached)
    assert not np.all(reached)


@pytest.fixture
def generators(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(on_policy, "seeded_generator", seeded_generator)


def rollout(kind: type[NativeBatch], scene: Scene, device: torch.device) -> Experience:
    """A rollout of eight steps in which episodes end, and others break."""
    torch.manual_seed(0)
    batch = kind(load_task("Lift"), 4, scene=scene, threads=1, horizon=3)
    config = PPOConfig(actor_hidden=(8,), critic_hidden=(8,), epochs=1, minibatches=2)
    spaces = Spaces(batch.observation_spec.dim, batch.action_dim)
    agent = PPO(config, spaces, gradients="torchrl", device=device)
    source = Rollout(TaskEnv(batch))
    experience = source.collect(agent.policy(), 8)
    agent.update(experience.batch)
    return experience


@pytest.mark.usefixtures("generators")
def test_a_rollout_stays_on_the_device(lift: Task, scene_of: SceneOf) -> None:
    scene = scene_of(lift, fidelity="fast")
    expected = rollout(NativeBatch, scene, CPU)
    result = rollout(SecondBatch, scene, SECOND)
    assert result.episodes == expected.episodes
    assert len(result.episodes) == 8
    assert result.reward_terms == pytest.approx(expected.reward_terms, rel=1e-5)
    for key, value in expected.batch.items(True, True):
        tensor = result.batch[key]
        assert tensor.device == SECOND, key
        torch.testing.assert_close(tensor.cpu(), value)


def test_what_is_not_finite_is_cut_off_on_the_device() -> None:
    cut = []
    for device in (CPU, SECOND):
        numbers = torch.tensor([[1.0, 2.0], [np.nan, 3.0]])
        flags = torch.tensor([True, True]).to(device)
        time_step = TimeStep(
            observation=numbers.to(device),
            reward=numbers[:, 1].to(device),
            reward_terms={"near": numbers[:, 0].to(device)},
            success=flags,
            milestones={"near": flags},
            terminated=flags,
            truncated=~flags,
        )
        last = np.full((2, 2), 7.0)
        cut.append(time_step.cut_off(time_step.finite(), last))
    assert on_host(cut[1].observation).tolist() == [[1.0, 2.0], [7.0, 7.0]]
    for expected, result in zip(*cut, strict=True):
        result = result["near"] if isinstance(result, dict) and result else result
        if isinstance(result, torch.Tensor):
            assert result.device == SECOND
            host = expected["near"] if isinstance(expected, dict) else expected
            torch.testing.assert_close(result.cpu(), host)


@pytest.mark.parametrize("number", [np.nan, np.inf])
def test_a_fault_on_the_device_ends_its_episode(number, lift, scene_of) -> None:
    batch = SecondBatch(lift, 3, scene=scene_of(lift, fidelity="fast"), threads=1)
    batch.begin(np.arange(3))
    action = torch.zeros(3, 7)
    action[1, 0] = number
    time_step = batch.step(action.to(SECOND))
    broken = [False, bool(np.isnan(number)), False]
    assert on_host(time_step.truncated).tolist() == broken
    assert batch.fault_count == sum(broken)
