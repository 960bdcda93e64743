"""manip's SAC and PPO as a training run uses them: `Agent.update` on rollouts.

The time includes storing the rollout, n-step returns or advantages, sampling,
gradients, Adam and the target networks.
"""

from collections.abc import Callable

import torch

from manip.agents.agent import Spaces
from manip.agents.ppo import PPO, PPOConfig
from manip.agents.sac import SAC, SACConfig
from manip.benchmarks.learner_problem import GAMMA, Problem, transitions

UPDATES_PER_STEP = 0.25
"""SAC updates per control step, the default of SACConfig."""


def sac(problem: Problem, threads: int, actor_delay: int) -> Callable[[], int]:
    """SAC with LayerNorm in the critics, and a buffer that is full."""
    agent = SAC(_sac_options(problem, actor_delay), _spaces(problem), threads)
    agent.update(transitions(problem, problem.num_envs, problem.stored_length))
    steps = round(problem.updates / UPDATES_PER_STEP)
    rollout = transitions(problem, problem.num_envs, -(-steps // problem.num_envs))

    def run() -> int:
        torch.set_num_threads(1)
        agent.update(rollout)
        return problem.updates

    return run


def _sac_options(problem: Problem, actor_delay: int) -> SACConfig:
    return SACConfig(
        gamma=GAMMA,
        batch_size=problem.batch,
        updates_per_step=UPDATES_PER_STEP,
        actor_delay=actor_delay,
        actor_hidden=problem.hidden,
        critic_hidden=problem.hidden,
        buffer_size=problem.stored,
        random_steps=problem.stored + 1,
    )


def ppo(problem: Problem, threads: int) -> Callable[[], int]:
    """PPO; the current policy computes the rollout's actions and log-probabilities."""
    agent = PPO(_ppo_options(problem), _spaces(problem), threads)
    rollout = transitions(problem, problem.num_envs, problem.length)

    def run() -> int:
        torch.set_num_threads(1)
        batch = rollout.clone()
        agent.update(agent.policy()(batch))
        return problem.epochs

    return run


def _ppo_options(problem: Problem) -> PPOConfig:
    return PPOConfig(
        gamma=GAMMA,
        rollout_length=problem.length,
        epochs=problem.epochs,
        minibatches=problem.rows // problem.minibatch,
        target_kl=None,
        actor_hidden=problem.hidden,
        critic_hidden=problem.hidden,
    )


def _spaces(problem: Problem) -> Spaces:
    return Spaces(problem.observation, problem.action)
