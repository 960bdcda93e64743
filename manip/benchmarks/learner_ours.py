"""This suite's learners as a training run uses them: `Agent.update` on rollouts.

All of it counts: storing the rollout, n-step returns or advantages, sampling,
gradients, Adam and the critics' targets.
"""

from collections.abc import Callable

import torch

from manip.agents.agent import Spaces
from manip.agents.ppo import PPO, PPOConfig
from manip.agents.sac import SAC, SACConfig
from manip.benchmarks.problem import GAMMA, Problem, transitions

SHARE = 0.25
"""SAC updates for each control step, as SACConfig has it by default."""


def sac(problem: Problem, threads: int, actor_delay: int) -> Callable[[], int]:
    """SAC; its critics have LayerNorm, which the peers' do not."""
    options = SACConfig(
        gamma=GAMMA,
        batch_size=problem.batch,
        updates_per_step=SHARE,
        actor_delay=actor_delay,
        actor_hidden=problem.hidden,
        critic_hidden=problem.hidden,
        buffer_size=problem.stored,
        random_steps=problem.stored + 1,
    )
    agent = SAC(options, _spaces(problem), threads)
    filling = problem.stored // problem.worlds
    agent.update(transitions(problem, problem.worlds, filling))
    steps = round(problem.updates / SHARE)
    rollout = transitions(problem, problem.worlds, -(-steps // problem.worlds))

    def go() -> int:
        torch.set_num_threads(1)
        agent.update(rollout)
        return problem.updates

    return go


def ppo(problem: Problem, threads: int) -> Callable[[], int]:
    """PPO on the actions and log-probabilities of its policy of the moment."""
    options = PPOConfig(
        gamma=GAMMA,
        rollout_length=problem.length,
        epochs=problem.epochs,
        minibatches=problem.rows // problem.minibatch,
        target_kl=None,
        actor_hidden=problem.hidden,
        critic_hidden=problem.hidden,
    )
    agent = PPO(options, _spaces(problem), threads)
    rollout = transitions(problem, problem.worlds, problem.length)

    def go() -> int:
        torch.set_num_threads(1)
        found = rollout.clone()
        agent.update(agent.policy()(found))
        return problem.epochs

    return go


def _spaces(problem: Problem) -> Spaces:
    return Spaces(problem.observation, problem.action)
