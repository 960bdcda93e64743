"""Adapters to other rooms as they are before the merge; deleted with it.

Each name becomes an import: `Purpose`, `EVALUATION`, `CHOICE` from
manip.envs.episode_streams; `check_observation` from manip.observation;
`end_with_parent` from manip.envs.backends.worker_pool. `parts_of(env, state)` becomes
`env.parts(state)`, `purpose_option(purpose)` becomes `{"purpose": purpose}`.
"""

import multiprocessing
import multiprocessing.connection
import os
import threading
from collections.abc import Mapping
from enum import IntEnum
from typing import Any

from tensordict import TensorDictBase


class Purpose(IntEnum):
    """What episodes are for."""

    TRAINING = 0
    EVALUATION = 1
    CHOICE = 2


_, EVALUATION, CHOICE = Purpose


def parts_of(env: Any, state: TensorDictBase) -> Any:
    """Named parts of the observation; the vector where there are none yet."""
    return env.parts(state) if hasattr(env, "parts") else state["observation"]


def check_observation(needed: Any, batch: Any) -> None:
    """Compare a card's layout with the batch's."""
    if isinstance(needed, Mapping):
        batch.check_layout(needed)


def purpose_option(purpose: Purpose) -> dict[str, Any]:
    """Nothing: batches take no purpose yet."""
    return {}


def end_with_parent() -> None:
    """End this worker process when its parent ends."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        arguments = (parent.sentinel,)
        threading.Thread(target=_end_after, args=arguments, daemon=True).start()


def _end_after(sentinel: int) -> None:
    multiprocessing.connection.wait([sentinel])
    os._exit(1)
