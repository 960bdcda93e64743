"""Cost of collecting in another process: what is copied, and how long that takes."""

import pickle
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from typing import Any

import torch
from tensordict.nn import TensorDictModuleBase

from manip.agents.agent import Agent
from manip.benchmarks.rounds import Candidate, Comparison, Settings, speed
from manip.cluster.policy_weights import split
from manip.cluster.ray_cluster import connected
from manip.cluster.ray_collectors import rollouts_on
from manip.cluster.remote_rollout import (
    Collected,
    CollectorProcess,
    RemoteRollout,
    State,
)
from manip.training.build import build_agent, training_env
from manip.training.collector import Rollout, RolloutSource
from manip.training.config import TrainConfig
from manip.training.recipes import recipe

HERE, COPIED = "rollouts of this process", "copied as between processes"
RAY = "of an actor on Ray"


class Copied:
    """A collector of this process; all that it gets and gives is serialised.

    Args:
        config: options of the run.
    """

    def __init__(self, config: TrainConfig) -> None:
        self._process = CollectorProcess(config, 0, 1)

    def collect(
        self, policy: TensorDictModuleBase, length: int, state: State | None
    ) -> Collected:
        """Collect a rollout; see `manip.cluster.remote_rollout.Collecting`."""
        arguments = _copied((policy, length, state))
        collected: Collected = _copied(self._process.collect(*arguments))
        return collected


def comparison(settings: Settings) -> Comparison:
    """Compare PPO's rollouts of this process with those of another one.

    The latter are serialised in this process and, where the package ray is installed,
    of an actor on this machine. The network between machines is not part of it.
    """
    torch.set_num_threads(1)  # as in training
    config = recipe(settings.task, "ppo")
    config = replace(config, num_envs=settings.num_envs, threads=1)
    agent = build_agent(config, training_env(config, 0, 1))
    sources = _sources(config)
    candidates = {name: _speed(source, agent) for name, source in sources.items()}
    ratios = {"copied_vs_here": (COPIED, HERE), "ray_vs_here": (RAY, HERE)}
    return Comparison(
        f"{settings.task}, {settings.num_envs} environments, rollouts of "
        f"{agent.rollout_length} steps, one thread",
        candidates,
        ratios={name: pair for name, pair in ratios.items() if pair[0] in sources},
        facts=_sizes(config, agent),
        task=settings.task,
    )


def _sources(config: TrainConfig) -> dict[str, RolloutSource]:
    env = training_env(config, 0, 1)
    sources: dict[str, RolloutSource] = {
        HERE: Rollout(training_env(config, 0, 1)),
        COPIED: RemoteRollout(env, lambda: Copied(config), "collector 0"),
    }
    if find_spec("ray"):
        (sources[RAY],) = rollouts_on(connected("local"), config, [env])
    return sources


def _speed(source: RolloutSource, agent: Agent) -> Candidate:
    return speed(_steps(source, agent))


def _steps(source: RolloutSource, agent: Agent) -> Callable[[], int]:
    return lambda: source.collect(agent.policy(), agent.rollout_length).steps


def _sizes(config: TrainConfig, agent: Agent) -> dict[str, float]:
    """Bytes that a rollout sends for each control step, and its policy once."""
    process = CollectorProcess(config, 0, 1)
    collected = process.collect(agent.policy(), agent.rollout_length, None)
    steps = collected.experience["steps"]
    return {
        "bytes_per_control_step": len(pickle.dumps(collected.experience)) / steps,
        "state_bytes_per_control_step": len(pickle.dumps(collected.state)) / steps,
        "policy_bytes": float(len(pickle.dumps(split(agent.policy())))),
    }


def _copied(value: Any) -> Any:
    return pickle.loads(pickle.dumps(value))
