"""A native batch that evaluates its task on the second torch device."""

import numpy as np
import torch
from second_device import SECOND

from manip.arrays import on_host
from manip.envs.backends.native_batch import NativeBatch
from manip.envs.task import Measures

Array = np.ndarray


class SecondBatch(NativeBatch):
    """A native batch that evaluates its task on the second device."""

    gives_tensors = True

    def _task_reads(self) -> Measures:
        return on(SECOND, self.read())

    def _move(self, action: torch.Tensor) -> Array:
        assert action.device == SECOND
        return super()._move(on_host(action))


def on(device: torch.device, read: Measures) -> dict[str, torch.Tensor | Array]:
    """Readings as tensors; a number that holds for all environments stays."""
    return {
        name: torch.tensor(values).to(device) if values.size > 1 else values
        for name, values in read.items()
    }
