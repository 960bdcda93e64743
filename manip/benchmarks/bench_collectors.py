"""Cost of collecting in another process: what is copied, and how long that takes."""

import pickle
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import torch
from tensordict.nn import TensorDictModuleBase

from manip.agents.agent import Agent
from manip.benchmarks.rounds import Comparison, Settings, speed
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
    """Compare PPO's rollouts of this process with those that are serialised.

    The network between the processes is not part of it.
    """
    torch.set_num_threads(1)  # as in training
    config = recipe(settings.task, "ppo")
    config = replace(config, num_envs=settings.num_envs, threads=1)
    env = training_env(config, 0, 1)
    agent = build_agent(config, env)
    copied = RemoteRollout(env, lambda: Copied(config), "collector 0")
    return Comparison(
        f"{settings.task}, {settings.num_envs} environments, rollouts of "
        f"{agent.rollout_length} steps, one thread",
        {
            HERE: speed(_steps(Rollout(training_env(config, 0, 1)), agent)),
            COPIED: speed(_steps(copied, agent)),
        },
        ratios={"copied_vs_here": (COPIED, HERE)},
        facts=_sizes(config, agent),
        task=settings.task,
    )


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
        "policy_bytes": float(len(pickle.dumps(agent.policy()))),
    }


def _copied(value: Any) -> Any:
    return pickle.loads(pickle.dumps(value))
