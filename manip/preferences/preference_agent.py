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
from torch import nn

from manip.agents.agent import Agent, AgentConfig
from manip.preferences.clip_pool import START_KEYS, ClipPool
from manip.preferences.label_rounds import Rounds


class PreferenceAgent(Agent):
    """Give an agent the rewards that are learned from comparisons.

    Args:
        agent: the algorithm.
        pool: takes the rollouts.
        rounds: has clips compared, and learns from the answers.
    """

    name = "preferences"
    Config = AgentConfig

    def __init__(self, agent: Agent, pool: ClipPool, rounds: Rounds) -> None:
        self._agent, self._pool, self._rounds = agent, pool, rounds
        self.actor, self.rollout_length = agent.actor, agent.rollout_length
        self._steps = self._round = 0
        self._news: dict[str, float] = {}

    def policy(self) -> TensorDictModuleBase:
        """See the agent."""
        return self._agent.policy()

    def update(self, batch: TensorDictBase) -> dict[str, float]:
        """Keep the clips of a rollout [N, T], and learn from it."""
        self._pool.add(batch)
        self._steps += batch.numel()
        batch = batch.exclude(*START_KEYS, *(("next", key) for key in START_KEYS))
        if not self._round:
            self._agent.store(batch)
            return {}
        learned = self._rounds.model(batch)
        news = self._news | {"learned_reward": learned.mean().item()}
        batch["next", "reward"] = self._rounds.reward(batch)
        self._news = {}
        return self._agent.update(batch) | news

    def waiting(self) -> str:
        """Have clips compared and learn a new reward, if it is time.

        Returns:
            How many answers of people are missing, and how to give them; empty if none.

        Raises:
            UserError: there are too few clips, or the folder's files do not fit.
        """
        if not self._rounds.due(self._round, self._steps):
            return ""
        missing = self._rounds.missing(self._round, self._pool)
        if missing:
            place = self._rounds.folder.folder
            return f"{missing} pairs of clips wait for answers: manip label {place}"
        pairs = self._rounds.learn(self._round)
        card = self._rounds.model.card
        self._agent.relabel(self._rounds.reward)
        self._news = self._agent.compare(pairs)
        self._news |= {"labels": self._rounds.labels, "label_accuracy": card.accuracy}
        self._round += 1
        return ""

    def modules(self) -> dict[str, nn.Module]:
        """The agent's, and the network of the learned reward."""
        network = {"learned_reward": self._rounds.model.network}
        return self._agent.modules() | network

    def optimisers(self) -> dict[str, torch.optim.Optimizer]:
        """See the agent."""
        return self._agent.optimisers()

    def extra_state(self, buffer: bool = True) -> dict[str, Any]:
        """The agent's, and under "preferences" the clips and where the rounds stand."""
        own = {
            "steps": self._steps,
            "round": self._round,
            "labels": self._rounds.labels,
            "pool": self._pool.state(),
        }
        return self._agent.extra_state(buffer) | {"preferences": own}

    def load_extra_state(self, state: dict[str, Any]) -> None:
        """Restore what `extra_state` returned.

        Raises:
            ValueError: it is of another run, or damaged.
            UserError: the folder of preferences is not the one that was used before.
        """
        own = state["preferences"]
        self._agent.load_extra_state(state)
        self._pool.load_state(own["pool"])
        self._steps, self._round = own["steps"], own["round"]
        self._rounds.labels = own["labels"]
        if min(self._steps, self._round, self._rounds.labels) < 0:
            raise ValueError("the counters of the rounds are out of range")
        self._rounds.folder.check_used(self._round)
