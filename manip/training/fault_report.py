"""Messages about non-finite numbers in environments and updates."""

from collections.abc import Iterator, Sequence

from manip.envs.adapters.torchrl import TaskEnv
from manip.training.nan_guard import NanGuard

MOST_MESSAGES = 20
"""Faults that a run reports one by one; metrics.csv counts them all."""


class FaultReport:
    """The faults of a run's environments and updates, each reported once."""

    def __init__(self, envs: Sequence[TaskEnv], guard: NanGuard) -> None:
        self._envs, self._guard = envs, guard
        self._reported = 0

    def count(self) -> int:
        """Faults of the run so far."""
        return sum(env.batch.fault_count for env in self._envs) + self._guard.count

    def messages(self) -> tuple[str, ...]:
        """A line for each fault since the last call, up to the limit of a run."""
        lines = list(self._new())[: MOST_MESSAGES - self._reported]
        self._reported += len(lines)
        return tuple(lines)

    def _new(self) -> Iterator[str]:
        for env in self._envs:
            while env.batch.faults:
                yield f"{env.batch.faults.popleft()}: its episode is lost"
        while self._guard.messages:
            yield f"{self._guard.messages.popleft()}: the update is lost"
