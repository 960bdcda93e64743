"""An agent that learns from comparisons of its clips instead of the task's reward.

    1. Its rollouts are cut into clips.
    2. Round 0, after `start` control steps, and then every `every` steps: choose pairs
       of recent clips, have them compared, fit the reward to all comparisons so far.
    3. In between, the agent inside learns as always, from the rewards of the model.

Christiano et al. 2017, arXiv 1706.03741. Before round 0 there is no reward: rollouts
are only stored. After each fit, stored rewards are replaced (PEBBLE, Lee et al. 2021,
arXiv 2106.05091).
"""

from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn

from manip.agents.agent import Agent, AgentConfig, Spaces
from manip.preferences.clip_pool import START_KEYS, ClipPool
from manip.preferences.label_options import LabelOptions
from manip.preferences.queries import choose_pairs
from manip.preferences.reward_learning import generator_of
from manip.preferences.reward_model import RewardModel, step_inputs
from manip.preferences.rounds import Rounds


class PreferenceAgent(Agent):
    """Give an agent the rewards that are learned from comparisons.

    Args:
        agent: the algorithm.
        options: when and how clips are compared.
        pool: takes the rollouts.
        rounds: has clips compared, and learns from the answers.
        seed: of the choice of pairs.
    """

    name = "preferences"
    Config = AgentConfig

    def __init__(  # type: ignore[override]
        self,
        agent: Agent,
        options: LabelOptions,
        pool: ClipPool,
        rounds: Rounds,
        seed: int,
    ) -> None:
        self._agent, self._options, self._seed = agent, options, seed
        self._pool, self._rounds = pool, rounds
        self._steps = self._round = 0
        self._logged: dict[str, float] = {}
        self.actor, self.rollout_length = agent.actor, agent.rollout_length
        self.off_policy = agent.off_policy  # type: ignore[misc]

    def policy(self) -> TensorDictModuleBase:
        """The agent's policy."""
        return self._agent.policy()

    def update(self, batch: TensorDictBase) -> dict[str, float]:
        """Keep the clips of a rollout [N, T], and learn from it."""
        self._pool.add(batch)
        self._steps += batch.numel()
        batch = batch.exclude(*START_KEYS, *(("next", key) for key in START_KEYS))
        if not self._round:
            self._agent.store(batch)
            return {}
        reward = self._rounds.model(batch)
        batch["next", "reward"] = reward
        learned = self._agent.update(batch)
        return learned | self._logged | {"learned_reward": reward.mean().item()}
...
