"""ClipSource: what all clips of a native batch have in common."""

from dataclasses import dataclass

from manip.envs.backends.native_batch import NativeBatch
from manip.envs.task_batch import TaskBatch
from manip.errors import UserError
from manip.preferences.clip_header import ClipHeader


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
