"""Tasks with several objects that the arm moves one at a time.

Each object has a task that moves it alone. One object is active: the one between the
finger pads, else the first that is not done. The measures, observation, shaped reward
and milestones of its task apply to it. Each environment has an active object of its
own.

Shaped reward, in [0, 1] per step: (number of objects done + shaped reward of the active
one, unless it is done) / number of objects.
"""

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Measures, Task, Waypoint
from manip.rewards.kernels import near
from manip.sim.scene import Scene
from manip.sim.sensors import Sensors
from manip.tasks.object_task import ObjectTask
from manip.tasks.one_at_a_time_waypoints import after_number, one_in_hand

Array = np.ndarray


class OneAtATime(Task):
    """Move each of K objects to its place; see the module's docstring.

    A subclass sets `sensors` to `sensors_of` its parts.

    Attributes:
        parts: object's name -> the task that moves it alone, in the order in which the
            objects are moved. Their functions of measures must hold for all objects.
        centre: [3] m, origin of the observed positions.
        object_pos: the position of the object among the measures of its task.
    """

    parts: ClassVar[Mapping[str, ObjectTask]]
    centre: ClassVar[Array]
    object_pos: ClassVar[str]

    def sample_waypoint(
        self, milestone: str, scene: Scene, streams: EpisodeStreams
    ) -> Waypoint:
        """See `manip.tasks.one_at_a_time_waypoints`."""
        parts, start = list(self.parts.values()), self.sample_start(scene, streams)
        counts = self._counts
        if milestone not in counts:
            return one_in_hand(parts, milestone, scene, streams, start)
        number = 1 + counts.index(milestone)
        return after_number(parts, number, scene, streams, start)

    @property
    def _counts(self) -> tuple[str, ...]:
        """The milestones that count the objects that are done, from 1 to K."""
        return self.milestone_names[-len(self.parts) :]

    @property
    def part(self) -> Task:
        """The task whose functions are applied to the measures of the active object."""
        return next(iter(self.parts.values()))

    def each(self, read: Measures) -> list[Measures]:
        """The measures of every object, by its own task."""
        return [task.measure(_view(read, name)) for name, task in self.parts.items()]

    def measure(self, read: Measures) -> Measures:
        """The measures of the active object, and which objects are done.

        done [N, K] bool: the object is in its place, and the tool away from it;
        active [N] int: number of the active object; finished [N] bool: it is done;
        all_pos [N, K, 3] m: where the objects are.
        """
        each = self.each(read)
        alone = zip(self.parts.values(), each, strict=True)
        done = np.stack([task.success(m) for task, m in alone], axis=1)
        grasped = of_all(each, "grasped")
        candidates = np.where(grasped.any(axis=1, keepdims=True), grasped, ~done)
        active = candidates.argmax(axis=1)
        return {
            **read,
            **_chosen(each, active, read),
            "done": done,
            "active": active,
            "finished": done[np.arange(len(active)), active],
            "all_pos": np.stack([m[self.object_pos] for m in each], axis=1),
        }

    def observe(self, m: Measures) -> dict[str, Array]:
        """The arm and the active object; its number; which are done; where all are."""
        places = 4.0 * (m["all_pos"] - self.centre)
        return {
            **self.part.observe(m),
            "active": np.eye(len(self.parts))[m["active"]],
            "done": m["done"].astype(float),
            "all_pos": places.reshape(len(places), -1),
        }

    def reward_terms(self, m: Measures, reward: str) -> dict[str, Array]:
        """Terms of the shaped or the stock reward.

        A shaped term is its mean over the objects: 1 of those that are done, and 0 of
        those that wait.
        """
        if reward == "stock":
            return self.stock_terms(m)
        number = m["done"].sum(axis=1)
        terms = self.part.reward_terms(m, "shaped")
        return {
            name: (number + ~m["finished"] * term) / len(self.parts)
            for name, term in terms.items()
        }

    @abstractmethod
    def stock_terms(self, m: Measures) -> dict[str, Array]:
        """Terms of robosuite's shaped reward."""

    def success(self, m: Measures) -> Array:
        """All objects are done."""
        return np.asarray(m["done"].all(axis=1))

    def milestones(self, m: Measures) -> dict[str, Array]:
        """Those of the active object, then how many objects are done."""
        flags, number = self.part.milestones(m), m["done"].sum(axis=1)
        own = self.milestone_names[: -len(self.parts)]
        return {
            **{name: flags[name] for name in own},
            **{name: number > index for index, name in enumerate(self._counts)},
        }

    def visible_measures(self, m: Measures) -> dict[str, Array]:
        """Those of the active object; done: number of objects that are done."""
        return {**self.part.visible_measures(m), "done": m["done"].sum(axis=1)}


def sensors_of(parts: Mapping[str, Sensors]) -> Sensors:
    """The sensors of several objects; names begin with the object's and _."""
    return Sensors(
        bodies=_prefixed({name: part.bodies for name, part in parts.items()}),
        sites=_prefixed({name: part.sites for name, part in parts.items()}),
        touches=_prefixed({name: part.touches for name, part in parts.items()}),
    )


def _prefixed(parts: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    return {
        f"{name}_{key}": target
        for name, part in parts.items()
        for key, target in part.items()
    }


def _view(read: Measures, name: str) -> Measures:
    """The readings, with those of one object named as its own task names them."""
    start = f"{name}_"
    own = {
        key.removeprefix(start): values
        for key, values in read.items()
        if key.startswith(start)
    }
    return {**read, **own}


def _chosen(each: Sequence[Measures], active: Array, read: Measures) -> Measures:
    """Of the measures of each object, those of the active one [N]."""
    rows, first = np.arange(len(active)), each[0]
    names = [name for name in first if first[name] is not read.get(name)]
    return {name: np.stack([m[name] for m in each])[active, rows] for name in names}


def of_all(each: Sequence[Measures], name: str) -> Array:
    """[N, K]: a measure [N] of each of K objects."""
    return np.stack([m[name] for m in each], axis=1)


def staged_reward(
    each: Sequence[Measures], waits: Array, below: Array, hover: Callable[..., Array]
) -> Array:
    """[N]: the largest of robosuite's stages over the objects that are not done.

    Both pads must touch objects that are not done, each perhaps another one. The stage
    of lifting uses the highest of these objects
    (`staged_rewards` of robosuite/environments/manipulation/nut_assembly.py).

    Args:
        each: measures of the K objects.
        waits: [N, K] bool: the object is not done.
        below: [N, K] m from the object up to the height of the full reward for lifting.
        hover: returns the stage [N, K] of carrying, given that of lifting [N, 1].
    """
    left, right = (
        ((of_all(each, f"{side}_touch") > 0) & waits).any(axis=1)
        for side in ("left", "right")
    )
    gap = np.where(waits, np.maximum(below, 0.0), np.inf).min(axis=1)
    lift = (left & right) * (0.35 + 0.15 * near(gap, 1 / 15))
    reach = 0.1 * near(of_all(each, "distance"), 0.1)
    stages = np.maximum(reach, hover(lift[:, None]))
    staged: Array = np.where(waits, stages, 0.0).max(axis=1)
    return staged
