"""A problem that can be learned in seconds: points on a line that should go to 0."""

from collections.abc import Sequence

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from manip.agents.agent import Agent, Spaces
from manip.agents.ppo import PPO, PPOConfig
from manip.agents.sac import SAC, SACConfig
from manip.evaluation.episodes import run_episodes
from manip.training.rollout import Rollout

SPACES = Spaces(observation_dim=1, action_dim=1)

QUICK_SAC = SACConfig(
    learning_rate=3e-3,
    actor_average=0.05,
    batch_size=64,
    actor_hidden=(32,),
    critic_hidden=(32,),
    target_entropy=-1.0,
    buffer_size=5_000,
    random_steps=320,
)
QUICK_PPO = PPOConfig(
    learning_rate=3e-3,
    rollout_length=20,
    minibatches=2,
    actor_hidden=(32,),
    critic_hidden=(32,),
)


class Points(EnvBase):
    """N points: x += 0.2 action, reward 1 - |x|, a time limit for each world.

    The observation is x in [-1, 1]. Success is |x| < 0.1; the only stage is being on
    the positive side. An episode starts at a uniform x, or at `start`.
    """

    batch_locked = True

    def __init__(
        self, limits: Sequence[int], seed: int = 0, start: float | None = None
    ) -> None:
        super().__init__(batch_size=[len(limits)], device=None)
        one = (len(limits), 1)
        self.limits = torch.tensor(limits).unsqueeze(-1)
        self.x, self.elapsed = torch.zeros(one), torch.zeros(one, dtype=torch.int64)
        self.start = start
        self._set_seed(seed)
        self.action_spec = Bounded(-1, 1, one)
        self.reward_spec = Unbounded(one)
        flag = Binary(1, one, dtype=torch.bool)
        self.observation_spec = Composite(
            observation=Unbounded(one), success=flag, stages=flag.clone(), shape=one[:1]
        )
        ends = ("done", "terminated", "truncated")
        self.full_done_spec = Composite({e: flag.clone() for e in ends}, shape=one[:1])

    def _reset(
        self, tensordict: TensorDictBase | None = None, **_: object
    ) -> TensorDictBase:
        which = torch.ones_like(self.elapsed, dtype=torch.bool)
        if tensordict is not None and "_reset" in tensordict.keys():
            which = tensordict["_reset"].view_as(which)
        drawn = torch.rand(self.x.shape, generator=self._generator) * 2 - 1
        fresh = drawn if self.start is None else torch.full_like(drawn, self.start)
        self.x = torch.where(which, fresh, self.x)
        self.elapsed = torch.where(which, 0, self.elapsed)
        return self._seen(truncated=torch.zeros_like(which))

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        moved = self.x + 0.2 * tensordict["action"].clamp(-1, 1)
        self.x = moved.clamp(-1, 1)
        self.elapsed = self.elapsed + 1
        seen = self._seen(truncated=self.elapsed >= self.limits)
        return seen.set("reward", 1 - self.x.abs())

    def _seen(self, truncated: Tensor) -> TensorDictBase:
        entries = {
            "observation": self.x.clone(),
            "success": self.x.abs() < 0.1,
            "stages": self.x > 0,
            "terminated": torch.zeros_like(truncated),
            "truncated": truncated,
            "done": truncated.clone(),
        }
        return TensorDict(entries, self.batch_size)

    def _set_seed(self, seed: int | None) -> None:
        self._generator = torch.Generator().manual_seed(seed or 0)


def make_agent(config: SACConfig | PPOConfig, seed: int) -> Agent:
    torch.manual_seed(seed)
    return PPO(config, SPACES) if isinstance(config, PPOConfig) else SAC(config, SPACES)


def train(config: SACConfig | PPOConfig, seed: int, steps: int) -> Agent:
    """An agent after `steps` control steps of 16 points."""
    agent = make_agent(config, seed)
    rollout = Rollout(Points([20] * 16, seed))
    for _ in range(steps // (16 * agent.rollout_length)):
        agent.update(rollout.collect(agent.policy(), agent.rollout_length).batch)
    return agent


def mean_return(agent: Agent) -> float:
    """Of the deterministic policy, over 100 episodes of 20 steps."""
    episodes = run_episodes(Points([20] * 100, seed=123), agent.actor.decide, 100)
    return sum(episode.total_reward for episode in episodes) / len(episodes)
