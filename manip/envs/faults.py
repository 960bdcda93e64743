"""Non-finite numbers in an environment: which, and where."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from manip.arrays import on_host

Array = np.ndarray


class Fault(NamedTuple):
    """Non-finite numbers, or diverged physics, in one step of one environment.

    Attributes:
        task: name of the task.
        what: "physics", "action", "observation 'cube_pos'", "reward term 'reach'", or
            several of them.
        env_id: index of the environment.
        episode: number of its episode.
        step: control steps of the episode, this one included.
    """

    task: str
    what: str
    env_id: int
    episode: int
    step: int

    def __str__(self) -> str:
        return (
            f"{self.task}: {self.what} of environment {self.env_id} is not finite in "
            f"step {self.step} of its episode {self.episode}"
        )

    @property
    def name(self) -> str:
        """A file name."""
        return f"env{self.env_id}-episode{self.episode}-step{self.step}"


def non_finite(
    kind: str, named: Mapping[str, Array], num_envs: int
) -> list[tuple[str, Array]]:
    """For each array [N] or [N, k]: "kind 'name'", and [N] bool where float32 fails."""
    with np.errstate(over="ignore"):
        finite = {
            f"{kind} {name!r}": np.isfinite(np.asarray(on_host(values), np.float32))
            for name, values in named.items()
        }
    return [
        (name, np.logical_not(values.reshape(num_envs, -1).all(axis=1)))
        for name, values in finite.items()
    ]
