"""How noisy and how biased estimates of the policy gradient are.

A policy on its way is held still, and many rollouts of whole episodes are collected
with it. The first steps of each give one gradient g = mean of grad log pi(a | s) w for
every choice of the weight w:

    the return R, the return less the baseline R - V, or what n steps say,
    r_t + ... + gamma^(n-1) r_{t+n-1} + gamma^n V(s_{t+n}) - V(s_t)

R sums rewards up to the time limit; gamma^k V(s_{t+k}) stands for what it cuts off.

    noise: trace of g's covariance / |mean of R - V's g|^2, of one rollout
    bias:  |mean of g - mean of R - V's g|^2 / |mean of R - V's g|^2

Means and covariance are over the rollouts; what chance alone would add to a squared
length, the trace over their number, is taken off. R - V has the same mean as R, so it
is the one that others are held against.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase
from torchrl.objectives.value import GAE

from manip.agents.a2c import A2C, A2CConfig
from manip.agents.value_targets import add_values, n_step_advantages
from manip.errors import UserError
from manip.training.build import build_agent, training_envs
from manip.training.collector import Rollout
from manip.training.config import TrainConfig, recipe

NS = (1, 2, 4, 8, 16, 32)
"""Numbers of steps that are compared."""

WORLDS = 32
"""TaskBatch of a rollout: noise is in inverse proportion to their number."""
LEARNING_RATE = 2e-3
"""Of the A2C that is looked at; the rest is as its recipe has it."""

BASELINE = "R - V"
"""The weight that the others are held against."""


@dataclass(frozen=True)
class Found:
    """Noise and bias of one weight, for one seed after so many steps of training."""

    task: str
    seed: int
    env_steps: int
    weight: str
    noise: float
    bias: float


def measure(
    task: str,
    seed: int,
    gamma: float,
    stages: Sequence[int],
    rollouts: int,
    length: int,
) -> Iterator[list[Found]]:
    """Train A2C and stop at every stage [control steps] to look at its gradients.

    Args:
        gamma: discount of A2C, and of the gradients.
        rollouts: collected with the policy of each stage, an episode of every world.
        length: control steps at the beginning of episodes that gradients are taken of.

    Raises:
        UserError: episodes are too short to look as many steps ahead as n says.
    """
    config = _config(task, seed, gamma)
    (env,) = training_envs(config)
    _check_length(length, env.batch.horizon)
    agent = build_agent(config, env)
    assert isinstance(agent, A2C)
    rollout, steps = Rollout(env), 0
    for stage in stages:
        while steps < stage:
            found = rollout.collect(agent.policy(), agent.rollout_length)
            steps += found.steps
            agent.update(found.batch)
        gradients = _sample(agent, env, rollouts, env.batch.horizon, length)
        rollout = Rollout(env)
        reference = gradients[BASELINE]
        yield [
            Found(task, seed, steps, weight, *_compare(sample, reference))
            for weight, sample in gradients.items()
        ]


def _config(task: str, seed: int, gamma: float) -> TrainConfig:
    tuned = recipe(task, "a2c")
    assert isinstance(tuned.agent, A2CConfig)
    options = replace(tuned.agent, gamma=gamma, learning_rate=LEARNING_RATE)
    return replace(tuned, seed=seed, num_envs=WORLDS, agent=options)


def _check_length(length: int, horizon: int) -> None:
    most = horizon - max(NS)
    if length > most:
        raise UserError(
            f"--length must be at most {most}, not {length}: {max(NS)} more control "
            f"steps are looked at, and an episode has {horizon}"
        )


def _sample(
    agent: A2C, env: EnvBase, count: int, horizon: int, length: int
) -> dict[str, Tensor]:
    """Weight -> [count, P] gradients by the actor's parameters, of new episodes."""
    found: dict[str, list[Tensor]] = {}
    params = [*agent.actor.body.parameters(), agent.actor.log_std]
    for _ in range(count):
        batch = Rollout(env).collect(agent.policy(), horizon).batch
        weights = _weights(agent, add_values(batch, agent.critic))
        log_prob = _log_prob(agent, batch[:, :length])
        for name, weight in weights.items():
            gain = (log_prob * weight[:, :length].squeeze(-1)).mean()
            parts = torch.autograd.grad(gain, params, retain_graph=True)
            row = torch.cat([part.flatten() for part in parts])
            found.setdefault(name, []).append(row)
    return {name: torch.stack(rows) for name, rows in found.items()}


def _log_prob(agent: A2C, batch: TensorDictBase) -> Tensor:
    distribution = agent.stochastic.get_dist(batch.select("observation"))
    log_prob: Tensor = distribution.log_prob(batch["action"])
    return log_prob


def _weights(agent: A2C, batch: TensorDictBase) -> dict[str, Tensor]:
    gamma = agent.config.gamma
    GAE(gamma=gamma, lmbda=1.0, value_network=None)(batch)
    weights = {"R": batch["value_target"], BASELINE: batch["advantage"]}
    for n in NS:
        n_step_advantages(batch, n, gamma, agent.critic)
        weights[f"n = {n}"] = batch["advantage"]
    return weights


def _compare(sample: Tensor, reference: Tensor) -> tuple[float, float]:
    """Noise and bias, relative to the reference's squared mean."""
    signal = _squared_mean(reference)
    bias = _squared_mean(sample - reference)
    return (sample.var(0).sum() / signal).item(), (bias / signal).item()


def _squared_mean(sample: Tensor) -> Tensor:
    """|mean|^2 of the vectors that [count, P] are drawn from, without bias."""
    chance = sample.var(0).sum() / len(sample)
    return (sample.mean(0).square().sum() - chance).clamp_min(0.0)
