"""Let the training environments of a run start from waypoints of its task."""

from collections.abc import Callable, Sequence

from manip.envs.adapters.torchrl import TaskEnv
from manip.envs.backends.native_batch import NativeBatch
from manip.envs.waypoint_starts import WaypointStarts
from manip.envs.waypoint_states import make_waypoint_states
from manip.errors import UserError
from manip.training.config import TrainConfig


def add_waypoints(
    config: TrainConfig,
    envs: Sequence[TaskEnv],
    report: Callable[[str], object] = lambda _: None,
) -> None:
    """Generate the states of the task's waypoints, if the run is to start from them.

    Args:
        config: options of the run; its seed determines the states.
        envs: training environments.
        report: called with a line about each waypoint.

    Raises:
        UserError: the task has no waypoints, or one of them gives too few states.
    """
    if not config.waypoint_fraction:
        return
    batches = [env.batch for env in envs]
    native = [batch for batch in batches if isinstance(batch, NativeBatch)]
    if len(native) < len(batches):
        raise UserError(
            f"{config.task} is not on the batch engine, which generates waypoints: "
            "leave --waypoint-fraction out"
        )
    task, scene = native[0].task, native[0].scene
    states = make_waypoint_states(task, scene, config.seed, config.threads, report)
    for batch in native:
        fraction = config.waypoint_fraction
        batch.waypoints = WaypointStarts(states, fraction, batch.num_envs)
