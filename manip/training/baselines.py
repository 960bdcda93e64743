"""Policies that need no training: a task's expert, random actions, a new network."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from manip.agents.policy import Policy
from manip.agents.policy_card import PolicyCard
from manip.envs.task import Task
from manip.envs.task_batch import TaskBatch
from manip.envs.task_registry import load_task
from manip.evaluation.episodes import Policy as ActionFunction
from manip.training.build import build_agent, evaluation_env, policy_of
from manip.training.recipes import recipe

Baseline = Literal["expert", "random", "untrained"]


@dataclass(frozen=True)
class ExpertPolicy:
    """The expert of a task, which sees its measures instead of the observation."""

    card: PolicyCard

    def acting_in(self, batch: TaskBatch) -> ActionFunction:
        """The actions of the batch's expert."""
        return lambda _: torch.from_numpy(batch.expert().astype(np.float32))


@dataclass(frozen=True)
class RandomPolicy:
    """Actions drawn evenly from [-1, 1], the same ones when an episode is repeated."""

    card: PolicyCard

    def acting_in(self, batch: TaskBatch) -> ActionFunction:
        """Random actions of the batch's next episodes."""
        numbers = batch.first_env + np.arange(batch.num_envs)
        generators = [
            np.random.default_rng([batch.seed, batch.purpose, number, episode])
            for number, episode in zip(numbers, batch.episode + 1, strict=True)
        ]

        def act(_: Mapping[str, Tensor]) -> Tensor:
            rows = [each.uniform(-1, 1, batch.action_dim) for each in generators]
            return torch.from_numpy(np.stack(rows).astype(np.float32))

        return act


AnyPolicy = Policy | ExpertPolicy | RandomPolicy


def load_baseline(kind: Baseline, name: str, robot: str) -> tuple[AnyPolicy, Task]:
    """A policy that needs no training, and its task.

    Args:
        kind: expert; random; untrained, SAC's network as a training with seed 0 begins.
        name: of the task, as in `load_task`.
        robot: the arm.

    Raises:
        UserError: no such task or arm, or the task has no expert.
    """
    task = load_task(name)
    config = replace(recipe(name, "sac", robot), eval_episodes=1)
    env = evaluation_env(config)
    untrained = policy_of(build_agent(config, env), config, env, 0)
    if kind == "untrained":
        return untrained, task
    card = replace(untrained.card, algo=kind)
    if kind == "random":
        return RandomPolicy(card), task
    env.reset()
    env.batch.expert()
    return ExpertPolicy(card), task
