"""Tasks that take tensors: torch computes what numpy does, on any device."""

from collections.abc import Iterator, Mapping

import numpy as np
import pytest
import torch
from conftest import SceneOf
from second_device import CPU, SECOND

from manip.arrays import on_host
from manip.envs.backends.native_batch import NativeBatch
from manip.envs.task import Measures, Task
from manip.envs.task_outputs import TaskOutputs, evaluate
from manip.envs.task_registry import load_task, task_names
from manip.observation import vector_spec
from manip.rewards.compose import weighted_sum

Array = np.ndarray

ABLE = ("Lift", "Reach", "Stack")


def test_these_tasks_take_tensors() -> None:
    able = [name for name in task_names() if load_task(name).takes_tensors]
    assert sorted(able) == [*ABLE]


def readings(task: Task, scene_of: SceneOf) -> Iterator[Measures]:
    """Readings of the expert's episodes, from their start to success."""
    batch = NativeBatch(task, 6, scene=scene_of(task), threads=1)
    batch.begin(np.arange(6))
    for step in range(60):
        if step % 6 == 0:
            yield {name: values.copy() for name, values in batch.read().items()}
        batch.step(batch.expert())


def on(device: torch.device, read: Measures) -> dict[str, torch.Tensor | Array]:
    """Readings as tensors; a number that holds for all environments stays."""
    return {
        name: torch.as_tensor(values).to(device) if values.size > 1 else values
        for name, values in read.items()
    }


def named(outputs: TaskOutputs) -> dict[str, Mapping[str, Array]]:
    flags = {"success": outputs.success, "failure": outputs.failure}
    return outputs._asdict() | flags_of(flags)


def flags_of(flags: Mapping[str, Array]) -> dict[str, Mapping[str, Array]]:
    return {name: {name: values} for name, values in flags.items()}


@pytest.mark.parametrize("reward", ["shaped", "stock"])
@pytest.mark.parametrize("name", ABLE)
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
