"""Measure the noise and the bias of policy gradient estimates.

Training is stopped, and many rollouts of whole episodes are collected with the current
policy. The first steps of each give one gradient g = mean of grad log pi(a | s) w for
every choice of the weight w:

    R        the return (REINFORCE)
    R - V    the return less a baseline
    n = k    r_t + ... + gamma^(k-1) r_{t+k-1} + gamma^k V(s_{t+k}) - V(s_t)

R sums rewards up to the time limit, and gamma^k V(s_{t+k}) replaces later rewards.

    noise: trace of g's covariance / |mean of R - V's g|^2, of one rollout
    bias:  |mean of g - mean of R - V's g|^2 / |mean of R - V's g|^2

Means and covariances are over the rollouts; see `bootstrap` for their estimates. R and
R - V have the same expected gradient, so R's bias is a control: it is zero, and its
estimate shows what chance alone gives.
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
from manip.studies.bootstrap import Comparison, compare
from manip.training.build import build_agent, training_envs
from manip.training.collector import Rollout
from manip.training.config import TrainConfig
from manip.training.recipes import recipe

NS = (1, 2, 4, 8, 16, 32)
"""Numbers of steps n that are compared."""

NUM_ENVS = 32
"""Environments of a rollout: noise is inversely proportional to their number."""

LEARNING_RATE = 2e-3
"""Of the A2C that is trained; its other options are those of its recipe."""

RETURN = "R"
"""The weight of REINFORCE, whose bias is zero."""

BASELINE = "R - V"
"""The weight that the others are compared with."""


@dataclass(frozen=True)
class GradientRow:
    """Noise and bias of one weight, for one seed, after some steps of training.

    The bounds are those of 95 % bootstrap intervals. nan: the rollouts are too few to
    estimate the value, or to bound it. bias_floor is the 95 % quantile of the bias
    that chance alone gives.
    """

    task: str
    seed: int
    env_steps: int
    weight: str
    noise: float
    noise_low: float
    noise_high: float
    bias: float
    bias_low: float
    bias_high: float
    bias_floor: float


@dataclass(frozen=True)
class GradientStudy:
    """Options of the study.

    Attributes:
        task: name of the task.
        gamma: discount of A2C, and of the gradients.
        stages: control steps of training after which gradients are measured.
        rollouts: collected at each stage, with one episode of each environment.
        length: control steps at the start of an episode that enter the gradient.
    """

    task: str
    gamma: float
    stages: Sequence[int]
    rollouts: int
    length: int


def measure(study: GradientStudy, seed: int) -> Iterator[list[GradientRow]]:
    """Train A2C, and yield a row per weight at every stage.

    Raises:
        UserError: episodes are too short for `length` plus the largest n.
    """
    config = _config(study.task, seed, study.gamma)
    (env,) = training_envs(config)
    _check_length(study.length, env.batch.horizon)
    agent = build_agent(config, env)
    assert isinstance(agent, A2C)
    rollout, steps = Rollout(env), 0
    for stage in study.stages:
        while steps < stage:
            experience = rollout.collect(agent.policy(), agent.rollout_length)
            steps += experience.steps
            agent.update(experience.batch)
        gradients = _sample(agent, env, study.rollouts, env.batch.horizon, study.length)
        rollout = Rollout(env)
        reference = gradients[BASELINE]
        yield [
            _row(study.task, seed, steps, weight, compare(sample, reference))
            for weight, sample in gradients.items()
        ]


def _row(
    task: str, seed: int, env_steps: int, weight: str, result: Comparison
) -> GradientRow:
    noise, bias = result.noise, result.bias
    values = noise.value, noise.low, noise.high, bias.value, bias.low, bias.high
    return GradientRow(task, seed, env_steps, weight, *values, result.floor)


def _config(task: str, seed: int, gamma: float) -> TrainConfig:
    tuned = recipe(task, "a2c")
    assert isinstance(tuned.agent, A2CConfig)
    options = replace(tuned.agent, gamma=gamma, learning_rate=LEARNING_RATE)
    return replace(tuned, seed=seed, num_envs=NUM_ENVS, agent=options)


def _check_length(length: int, horizon: int) -> None:
    most = horizon - max(NS)
    if length > most:
        raise UserError(
            f"--length must be at most {most}, not {length}: {max(NS)} more control "
            f"steps are needed, and an episode has {horizon}"
        )


def _sample(
    agent: A2C, env: EnvBase, count: int, horizon: int, length: int
) -> dict[str, Tensor]:
    """Gradients by the actor's parameters, of new episodes: weight -> [count, P]."""
    gradients: dict[str, list[Tensor]] = {}
    params = [*agent.actor.body.parameters(), agent.actor.log_std]
    for _ in range(count):
        batch = Rollout(env).collect(agent.policy(), horizon).batch
        weights = _weights(agent, add_values(batch, agent.critic))
        log_prob = _log_prob(agent, batch[:, :length])
        for name, weight in weights.items():
            gain = (log_prob * weight[:, :length].squeeze(-1)).mean()
            parts = torch.autograd.grad(gain, params, retain_graph=True)
            row = torch.cat([part.flatten() for part in parts])
            gradients.setdefault(name, []).append(row)
    return {name: torch.stack(rows) for name, rows in gradients.items()}


def _log_prob(agent: A2C, batch: TensorDictBase) -> Tensor:
    distribution = agent.stochastic.get_dist(batch.select("observation"))
    log_prob: Tensor = distribution.log_prob(batch["action"])
    return log_prob


def _weights(agent: A2C, batch: TensorDictBase) -> dict[str, Tensor]:
    gamma = agent.config.gamma
    GAE(gamma=gamma, lmbda=1.0, value_network=None)(batch)
    weights = {RETURN: batch["value_target"], BASELINE: batch["advantage"]}
    for n in NS:
        n_step_advantages(batch, n, gamma, agent.critic)
        weights[f"n = {n}"] = batch["advantage"]
    return weights
