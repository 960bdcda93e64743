"""manip's PPO and SAC on Pendulum-v1."""

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np
import torch
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from tensordict import TensorDict, TensorDictBase

from manip.agents.agent import Agent, Spaces
from manip.agents.ppo import PPO, PPOConfig
from manip.agents.sac import SAC, SACConfig
from manip.benchmarks.pendulum import NET, NUM_ENVS, STEPS, Act, pendulum


def _ppo() -> Agent:
    config = PPOConfig(
        gamma=0.9,
        learning_rate=1e-3,
        rollout_length=256,
        epochs=10,
        minibatches=32,
        entropy_coefficient=0.0,
        max_gradient=0.5,
        target_kl=None,
        normalise=False,
        actor_hidden=NET,
        critic_hidden=NET,
    )
    return PPO(config, Spaces(3, 1))


def _sac() -> Agent:
    config = SACConfig(
        gamma=0.99,
        learning_rate=1e-3,
        rollout_length=1,
        n_step=1,
        tau=0.005,
        batch_size=256,
        updates_per_step=1.0,
        actor_delay=1,
        random_steps=500,
        initial_alpha=1.0,
        target_entropy=-1.0,
        actor_hidden=NET,
        critic_hidden=NET,
    )
    return SAC(config, Spaces(3, 1))


AGENTS: Mapping[str, Callable[[], Agent]] = {"PPO": _ppo, "SAC": _sac}


def learn(algo: str, seed: int) -> Act:
    """Train for the algorithm's number of steps and return the policy."""
    torch.manual_seed(seed)
    agent = AGENTS[algo]()
    envs = SyncVectorEnv(
        [pendulum] * NUM_ENVS[algo], autoreset_mode=AutoresetMode.SAME_STEP
    )
    observation, _ = envs.reset(seed=seed)
    steps = 0
    while steps < STEPS[algo]:
        batch, observation = _collect(envs, observation, agent)
        steps += batch.numel()
        agent.update(batch)
    return partial(_decide, agent)


def _collect(
    envs: SyncVectorEnv, observation: np.ndarray, agent: Agent
) -> tuple[TensorDictBase, np.ndarray]:
    """Collect a batch [N, T]; return it with the observation after its last step."""
    policy, steps = agent.policy(), []
    for _ in range(agent.rollout_length):
        before = torch.from_numpy(observation.copy())
        step = policy(TensorDict({"observation": before}, [len(before)]))
        observation, reward, _, truncated, info = envs.step(step["action"].numpy())
        after = np.stack(info["final_obs"]) if truncated.all() else observation
        steps.append(step.set("next", _after(after, reward, truncated)))
    return torch.stack(steps, 1), observation


def _after(after: np.ndarray, reward: np.ndarray, truncated: np.ndarray) -> TensorDict:
    """The result of a step; all environments reach the time limit at the same step."""
    ended = torch.from_numpy(truncated).unsqueeze(-1)
    entries = {
        "observation": torch.from_numpy(after.copy()),
        "reward": torch.from_numpy(reward).float().unsqueeze(-1),
        "truncated": ended,
        "terminated": torch.zeros_like(ended),
        "done": ended,
    }
    return TensorDict(entries, [len(after)])


@torch.no_grad()
def _decide(agent: Agent, observation: np.ndarray) -> np.ndarray:
    return agent.actor.decide(torch.from_numpy(observation)).numpy()
