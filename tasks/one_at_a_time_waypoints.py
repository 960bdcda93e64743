"""Waypoints of tasks with several objects: some are done, one is in the hand.

Of K objects, the first of the order lie in their places, where nothing holds them; the
others are at their starts. Waypoints of two kinds follow:

* those of an object's own task: 0 to K - 1 objects are done, each number as often; the
  next object is in the closed hand, as in its own task;
* counts: a number of objects is done, and the open hand is above the last of them.
"""

from collections.abc import Sequence

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Start, Waypoint
from manip.sim.scene import Scene
from manip.tasks.held_objects import above
from manip.tasks.object_task import ObjectTask

Array = np.ndarray
Parts = Sequence[ObjectTask]
"""The tasks of K objects, in the order in which these are moved."""


def one_in_hand(
    parts: Parts, milestone: str, scene: Scene, streams: EpisodeStreams, start: Start
) -> Waypoint:
    """Some objects done, the next in the hand at a milestone of its own task.

    start: all objects at their starts.
    """
    number = (len(parts) * streams.uniform(0, 1, 1)[:, 0]).astype(np.int64)
    start = _with_done(parts, number, scene, streams, start)
    each = [
        part.place_in_hand(milestone, scene, streams, Start(start.qpos.copy()))
        for part in parts
    ]
    return Waypoint(
        Start(_of_row([waypoint.start.qpos for waypoint in each], number)),
        _of_row([waypoint.tool_pos for waypoint in each], number),
        _of_row([waypoint.tool_mat for waypoint in each], number),
    )


def after_number(
    parts: Parts, number: int, scene: Scene, streams: EpisodeStreams, start: Start
) -> Waypoint:
    """A number of objects, at least 1, done, and the open hand above the last one.

    start: all objects at their starts.
    """
    each = np.full(len(streams), number)
    start = _with_done(parts, each, scene, streams, start)
    last = start.qpos[:, scene.free_qpos(parts[number - 1].body)]
    return above(streams, start, last[:, :3])


def _with_done(
    parts: Parts, number: Array, scene: Scene, streams: EpisodeStreams, start: Start
) -> Start:
    """The start with the first `number` [n] objects in their places."""
    qpos = start.qpos.copy()
    for index, part in enumerate(parts):
        body, rest = scene.free_qpos(part.body), part.sample_rest(streams)
        qpos[:, body] = np.where((index < number)[:, None], rest, qpos[:, body])
    return start._replace(qpos=qpos)


def _of_row(each: Sequence[Array], number: Array) -> Array:
    """[n, k]: row i of array `number[i]` of several [n, k]."""
    return np.stack(each)[number, np.arange(len(number))]
