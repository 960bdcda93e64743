"""A problem that is learned in seconds: points on a line that should move to 0."""

from collections.abc import Sequence
from types import SimpleNamespace

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from manip.agents.a2c import A2CConfig
from manip.agents.agent import Agent, AgentConfig, Spaces
from manip.agents.dqn import DQNConfig
from manip.agents.ppo import PPOConfig
from manip.agents.ppo_kl import PPOKLConfig
from manip.agents.registry import algorithm_names, load_algorithm
from manip.agents.reinforce import ReinforceConfig
from manip.agents.sac import SACConfig
from manip.agents.td3 import TD3Config
from manip.agents.trpo import TRPOConfig
from manip.evaluation.episodes import run_episodes
from manip.observation import ObservationPart, ObservationSpec
from manip.training.collector import Rollout

ALGORITHMS = {
    load_algorithm(name).Config: load_algorithm(name) for name in algorithm_names()
}
"""Options -> algorithm."""

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
QUICK_A2C = A2CConfig(
    learning_rate=1e-2, gamma=0.9, actor_hidden=(32,), critic_hidden=(32,)
)
QUICK_REINFORCE = ReinforceConfig(
    learning_rate=1e-2,
    rollout_length=10,
    gamma=0.9,
    actor_hidden=(32,),
    critic_hidden=(32,),
)
QUICK_TRPO = TRPOConfig(
    learning_rate=3e-3,
    rollout_length=20,
    minibatches=2,
    actor_hidden=(32,),
    critic_hidden=(32,),
)
QUICK_PPO_KL = PPOKLConfig(
    learning_rate=3e-3,
    rollout_length=20,
    minibatches=2,
    actor_hidden=(32,),
    critic_hidden=(32,),
)
QUICK_TD3 = TD3Config(
    gamma=0.9,
    n_step=1,
    learning_rate=1e-3,
    updates_per_step=0.5,
    exploration_noise=0.5,
    batch_size=64,
    actor_hidden=(32,),
    critic_hidden=(32,),
    buffer_size=5_000,
    random_steps=320,
)
QUICK_DQN = DQNConfig(
    learning_rate=3e-3,
    batch_size=64,
    critic_hidden=(32,),
    buffer_size=5_000,
    random_steps=320,
)


class Points(EnvBase):
    """N points: x += 0.2 action, reward 1 - |x|, a time limit for each environment.

    The observation is x in [-1, 1]. Success is |x| < 0.1; the only milestone is x > 0.
    An episode starts at a uniform x, or at `start`.
    """

    batch_locked = True
    batch = SimpleNamespace(
        observation_spec=ObservationSpec(
            (ObservationPart("x", (1,), "float32", "object"),)
        )
    )

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
            observation=Unbounded(one),
            success=flag,
            milestones=flag.clone(),
            reward_terms=Unbounded(one),
            shape=one[:1],
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
        return self._tensors(truncated=torch.zeros_like(which))

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        moved = self.x + 0.2 * tensordict["action"].clamp(-1, 1)
        self.x = moved.clamp(-1, 1)
        self.elapsed = self.elapsed + 1
        tensors = self._tensors(truncated=self.elapsed >= self.limits)
        return tensors.set("reward", 1 - self.x.abs())

    def _tensors(self, truncated: Tensor) -> TensorDictBase:
        entries = {
            "observation": self.x.clone(),
            "success": self.x.abs() < 0.1,
            "milestones": self.x > 0,
            "reward_terms": 1 - self.x.abs(),
            "terminated": torch.zeros_like(truncated),
            "truncated": truncated,
            "done": truncated.clone(),
        }
        return TensorDict(entries, self.batch_size)

    def parts(self, state: TensorDictBase) -> dict[str, Tensor]:
        return {"x": state["observation"]}

    def _set_seed(self, seed: int | None) -> None:
        self._generator = torch.Generator().manual_seed(seed or 0)


def make_agent(config: AgentConfig, seed: int) -> Agent:
    torch.manual_seed(seed)
    return ALGORITHMS[type(config)](config, SPACES)


def train(config: AgentConfig, seed: int, steps: int) -> Agent:
    """Train an agent for `steps` control steps of 16 points."""
    agent = make_agent(config, seed)
    rollout = Rollout(Points([20] * 16, seed))
    for _ in range(steps // (16 * agent.rollout_length)):
        agent.update(rollout.collect(agent.policy(), agent.rollout_length).batch)
    return agent


def mean_return(agent: Agent) -> float:
    """Return of the deterministic policy, mean of 100 episodes of 20 steps."""
    env = Points([20] * 100, seed=123)
    episodes = run_episodes(env, lambda parts: agent.actor.decide(parts["x"]), 100)
    return sum(episode.total_reward for episode in episodes) / len(episodes)


def rollout_of(agent: Agent, length: int = 12) -> TensorDictBase:
    """Collect a rollout in which episodes end at different times."""
    return Rollout(Points([3, 5, 50, 50])).collect(agent.policy(), length).batch


def three_steps(terminated: bool) -> TensorDict:
    """Three steps of one environment with V(s) = s; the second ends its episode."""
    ended = torch.tensor([[[0], [1], [0]]], dtype=torch.bool)
    after = {
        "observation": torch.tensor([[[1.0], [4.0], [2.5]]]),
        "reward": torch.tensor([[[1.0], [2.0], [3.0]]]),
        "done": ended,
        "terminated": ended & terminated,
    }
    start = torch.tensor([[[0.5], [1.0], [1.5]]])
    before = {"observation": start, "action": torch.zeros(1, 3, 1)}
    return TensorDict({**before, "next": TensorDict(after, [1, 3])}, [1, 3])
