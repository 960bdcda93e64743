"""FaultRecorder: what task batches do about numbers that are not finite."""

from collections import deque
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from manip.envs.faults import Fault, non_finite
from manip.envs.task import Task
from manip.envs.task_outputs import TaskOutputs
from manip.errors import UserError

Array = np.ndarray


class FaultRecorder:
    """Count and describe the faults of N environments; a base of `TaskBatch`.

    Attributes:
        faults: the latest faults; the reader removes those that it has reported.
        fault_count: number of faults so far.
        stop_at_faults: whether a fault raises UserError.
        dump_folder: where the native backend writes steps with non-finite numbers, one
            file each, for `manip replay`; None for nowhere.
    """

    task: Task
    elapsed: Array
    episode: Array
    stop_at_faults = False
    dump_folder: Path | None = None

    def __init__(self) -> None:
        self.faults: deque[Fault] = deque(maxlen=1000)
        self.fault_count = 0

    def _record_faults(self, kinds: Sequence[tuple[str, Array]]) -> None:
        """Record a fault for each environment [N] bool in which a kind is wrong."""
        wrong = np.any([where for _, where in kinds], axis=0)
        for env_id in map(int, np.flatnonzero(wrong)):
            what = ", ".join(name for name, where in kinds if where[env_id])
            clock = int(self.episode[env_id]), int(self.elapsed[env_id])
            self._add_fault(Fault(self.task.name, what, env_id, *clock))

    def _record_outputs(self, outputs: TaskOutputs) -> None:
        """Record the parts and terms of a step that are not finite."""
        num_envs = len(self.elapsed)
        self._record_faults(
            non_finite("observation", outputs.parts, num_envs)
            + non_finite("reward term", outputs.terms, num_envs)
        )

    def _add_fault(self, fault: Fault) -> None:
        self.faults.append(fault)
        self.fault_count += 1
        hint = self._dump(fault)
        if self.stop_at_faults:
            raise UserError(f"{fault}{hint}")

    def _dump(self, fault: Fault) -> str:
        """Store the step of a fault if possible; a hint how to replay it."""
        return ""
