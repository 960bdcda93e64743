"""Collectors in actors of a Ray cluster: `manip train --collectors K --ray ADDRESS`."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

from manip.cluster.policy_weights import SharedWeights, Weights, whole
from manip.cluster.ray_cluster import connected
from manip.cluster.remote_rollout import (
    Collected,
    CollectorProcess,
    LostError,
    RemoteRollout,
    State,
)
from manip.envs.adapters.torchrl import TaskEnv
from manip.errors import UserError
from manip.sim.robosuite_log import quiet_robosuite
from manip.training.config import TrainConfig
from manip.training.groups import check_elsewhere
from manip.training.run_parts import Place
from manip.versions import differences, versions

BEGIN_WITHIN = 300.0
"""Seconds within which a collector must find a free CPU and build its environments."""


@contextmanager
def ray_collectors(address: str) -> Iterator[Place]:
    """Have the environments of a run stepped by actors of a Ray cluster.

    Each group of environments has an actor, which takes one CPU. The weights of a
    policy are stored once and read by all actors. An actor that is lost is replaced.

    Yields:
        the `place` of `manip.training.run.train`.

    Raises:
        UserError: Ray is not installed, or there is no cluster at the address.
    """
    ray = connected(address)
    try:
        yield partial(rollouts_on, ray)
    finally:
        ray.shutdown()


def rollouts_on(
    ray: Any, config: TrainConfig, envs: Sequence[TaskEnv]
) -> list[RemoteRollout]:
    """Have the groups of a run's environments stepped by actors.

    Args:
        ray: the package, after `manip.cluster.ray_cluster.connected`.
        config: options of the run.
        envs: its groups of environments, for their shapes.

    Raises:
        UserError: the run cannot be split, or the cluster has too few CPUs.
    """
    check_elsewhere(config, "--ray")
    _check_room(ray, len(envs))
    shared = SharedWeights(ray.put)
    return [
        RemoteRollout(
            env,
            partial(_Collector, ray, shared, config, group, len(envs)),
            f"collector {group}",
        )
        for group, env in enumerate(envs)
    ]


def _check_room(ray: Any, collectors: int) -> None:
    cpus = int(ray.cluster_resources().get("CPU", 0))
    if cpus < collectors:
        raise UserError(
            f"{collectors} collectors take a CPU each, but the Ray cluster has {cpus}: "
            "add machines, or choose fewer --collectors"
        )


class _Collector:
    """An actor, as `manip.cluster.remote_rollout.Collecting`.

    Raises:
        UserError: it finds no free CPU, or its machine has other versions.
        LostError: it is lost before it begins.
    """

    def __init__(
        self,
        ray: Any,
        shared: SharedWeights,
        config: TrainConfig,
        group: int,
        groups: int,
    ) -> None:
        self._ray, self._shared = ray, shared
        actor = ray.remote(num_cpus=1)(_Actor)
        self._actor = actor.remote(config, group, groups)
        self._get(self._actor.build.remote(versions()), BEGIN_WITHIN)

    def collect(self, policy: Any, length: int, state: State | None) -> Collected:
        """Collect a rollout, from a state if one is given."""
        weights, rest = self._shared.split(policy)
        task = self._actor.collect.remote(weights, rest, length, state)
        collected: Collected = self._get(task)
        return collected

    def _get(self, task: Any, within: float | None = None) -> Any:
        """The result of a call of the actor.

        Raises:
            LostError: the actor, its machine or the result is lost.
            UserError: there is no result in time.
        """
        errors = self._ray.exceptions
        try:
            return self._ray.get(task, timeout=within)
        except errors.RayTaskError as error:  # what the actor raised
            raise error.cause from None
        except errors.GetTimeoutError as error:
            raise UserError(
                f"a collector has not begun within {within:.0f} s: the Ray cluster has "
                "no free CPU (see `ray status`)"
            ) from error
        except errors.RayError as error:
            raise LostError(str(error).splitlines()[0]) from error


class _Actor:
    """What runs on the other machine."""

    def __init__(self, config: TrainConfig, group: int, groups: int) -> None:
        self._arguments = config, group, groups
        self._process: CollectorProcess

    def build(self, expected: dict[str, str]) -> None:
        """Build the environments.

        Raises:
            UserError: packages have other versions than expected, or what
                `CollectorProcess` raises.
        """
        if different := differences(expected):
            raise UserError(different)
        quiet_robosuite()
        self._process = CollectorProcess(*self._arguments)

    def collect(
        self, weights: Weights, rest: bytes, length: int, state: State | None
    ) -> Collected:
        """Collect a rollout with the policy of which weights and rest are given."""
        return self._process.collect(whole(weights, rest), length, state)
