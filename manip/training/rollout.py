"""Collecting experience: the worlds move on where they stopped, also while learning."""

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase

from manip.agents.agent import Agent
from manip.envs.torchrl import NativeEnv, OtherEnv
from manip.evaluation.episodes import Episode, EpisodeTracker


@dataclass(frozen=True)
class Experience:
    """A rollout [N, T], and the episodes that ended in it."""

    batch: TensorDictBase
    episodes: list[Episode]


class Rollout:
    """Steps an environment with a policy; episodes go on across calls.

    Ten lines instead of torchrl.collectors.Collector, because where the worlds stand
    must be saved and restored for a run to resume.
    """

    def __init__(self, env: EnvBase) -> None:
        self._env = env
        self.tracker = EpisodeTracker(env.batch_size[0])
        self.state = env.reset()

    def collect(self, policy: TensorDictModuleBase, length: int) -> Experience:
        """The next `length` steps of all worlds."""
        steps, episodes = [], []
        for _ in range(length):
            step, self.state = self._env.step_and_maybe_reset(policy(self.state))
            episodes += self.tracker.update(step["next"])
            steps.append(step)
        return Experience(torch.stack(steps, 1), episodes)


class Collector:
    """Rollouts for an agent, one after the other, each with its policy of that time.

    With `ahead`, the next rollout is under way while the agent learns from the last
    one: its policy is then always one update old, however fast either is, so that a
    run still repeats itself bit for bit.
    """

    def __init__(self, env: NativeEnv | OtherEnv, agent: Agent, ahead: bool) -> None:
        self._env, self._agent, self._ahead = env, agent, ahead
        self._rollout = Rollout(env)
        self._pool = ThreadPoolExecutor(1, "manip-collect")
        self._under_way: Future[Experience] | None = None

    def next(self) -> Experience:
        """The next rollout, as soon as it is there."""
        found = (self._under_way or self._begin()).result()
        self._under_way = self._begin() if self._ahead else None
        return found

    def _begin(self) -> Future[Experience]:
        policy, length = self._agent.policy(), self._agent.rollout_length
        return self._pool.submit(self._rollout.collect, policy, length)

    def save_state(self) -> dict[str, Any]:
        """Worlds, episodes under way, and the rollout that nobody has learned from."""
        waiting = self._under_way.result() if self._under_way else None
        return {
            "env": self._env.worlds.save_state(),
            "tracker": self._rollout.tracker.save_state(),
            "batch": waiting and waiting.batch.to_dict(),
            "episodes": waiting and [asdict(episode) for episode in waiting.episodes],
        }

    def load_state(self, state: dict[str, Any]) -> None:
        """Put back what `save_state` gave.

        Raises:
            ValueError: the state is of other worlds.
        """
        self._env.worlds.load_state(state["env"])
        self._rollout.tracker.load_state(state["tracker"])
        self._rollout.state = self._env.look()
        self._under_way = None
        if state["batch"] is not None:
            size = (self._env.worlds.num_worlds, self._agent.rollout_length)
            batch = TensorDict(state["batch"], size)
            batch["next"].batch_size = size
            episodes = [Episode(**episode) for episode in state["episodes"]]
            self._under_way = Future()
            self._under_way.set_result(Experience(batch, episodes))
