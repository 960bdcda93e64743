"""ClipSource: cut clips from rollouts of the native batch."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from tensordict import TensorDictBase

from manip.envs.backends.native_batch import NativeBatch
from manip.envs.task_batch import TaskBatch
from manip.errors import UserError
from manip.preferences.clip_header import ClipHeader
from manip.preferences.clips import Clip

Array = np.ndarray

START = ("states", "readings", "motion")
"""Rows of `NativeBatch.record` from which a clip is repeated."""


def not_recordable(task: str) -> UserError:
    """Build the error for a task that does not run on the batch engine."""
    return UserError(
        f"clips need the states of the batch engine, which {task} does not run on: "
        "choose one of its tasks (see `manip list`)"
    )


@dataclass(frozen=True)
class ClipSource:
    """What all clips of a batch have in common.

    Attributes:
        header: of its clips, with env, episode and step 0.
        first_env: number of the batch's first environment.
        nq: length of qpos, the first columns of a state row.
        widths: length of an observation and of an action.
    """

    header: ClipHeader
    first_env: int
    nq: int
    widths: tuple[int, int]

    @classmethod
    def of(cls, batch: TaskBatch, task: str) -> "ClipSource":
        """The source of a native batch; `task` is its name as in `load_task`.

        Raises:
            UserError: the batch is not native, so its states cannot be recorded.
        """
        if not isinstance(batch, NativeBatch):
            raise not_recordable(task)
        header = ClipHeader(
            task=task,
            robot=batch.robot.arm,
            controller=batch.robot.controller,
            control_freq=batch.robot.control_freq,
            fidelity=batch.fidelity,
            reward_set=batch.reward_set,
            reward_weights={n: float(w) for n, w in batch.reward_weights.items()},
            seed=batch.seed,
            purpose=batch.purpose.name.lower(),
            env=0,
            episode=0,
            step=0,
            actor="",
            measure_names=batch.measure_names,
        )
        widths = batch.observation_spec.dim, batch.action_dim
        return cls(header, batch.first_env, batch.scene.physics.nq, widths)

    def cut(
        self,
        rollout: TensorDictBase,
        env_id: int,
        start: int,
        length: int,
        actor: str,
    ) -> Clip:
        """Cut steps start to start + length of an environment from a rollout [N, T].

        Args:
            rollout: of a `TaskEnv` with measures and states.
            env_id: the environment's row of the rollout.
            start, length: [control steps]. No episode may end before the last step.
            actor: who acted, in words.
        """
        steps = rollout[env_id, start : start + length]
        after = steps["next"]
        begin = {name: steps[name][0].numpy().copy() for name in START}
        joints = np.concatenate([steps["states"], after["states"][-1:]])[:, : self.nq]
        origin: Mapping[str, Any] = {
            "env": int(self.first_env + env_id),
            "episode": int(steps["episode"][0]),
            "step": int(steps["elapsed"][0]),
        }
        return Clip(
            header=replace(self.header, actor=actor, **origin),
            qpos=joints.copy(),
            **begin,
            **{n: steps[n].numpy().copy() for n in ("observation", "action")},
            **{n: after[n].numpy().copy() for n in ("measures", "reward_terms")},
        )


def whole_clips(rollout: TensorDictBase, length: int) -> Array:
    """[n, 2] int: environment and start of every piece of `length` steps of a rollout
    [N, T] in which no episode ends, except with its last step; pieces do not overlap.
    """
    done = rollout["next", "done"][..., 0].numpy()
    starts = []
    for env_id, ends in enumerate(done):
        begin = 0
        for end in (*np.flatnonzero(ends) + 1, len(ends)):
            starts += [(env_id, s) for s in range(begin, end - length + 1, length)]
            begin = end
    return np.array(starts, np.int64).reshape(-1, 2)
