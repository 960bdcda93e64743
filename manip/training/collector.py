"""Collecting experience: the worlds move on where they stopped, also while learning."""

from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase

from manip.agents.agent import Agent
from manip.envs.adapters.torchrl import TaskEnv
from manip.evaluation.episodes import Episode, EpisodeTracker


@dataclass(frozen=True)
class Experience:
    """What an agent learns from at once, and how it came about.

    batch: as `Agent.process_rollout` gave it; steps: control steps it took; episodes: those that
    ended in it.
    """

    batch: TensorDictBase
    steps: int
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
        """The next `length` steps of all worlds, a batch [N, T]."""
        steps, episodes = [], []
        for _ in range(length):
            step, self.state = self._env.step_and_maybe_reset(policy(self.state))
            episodes += self.tracker.update(step["next"])
            steps.append(step)
        batch = torch.stack(steps, 1)
        return Experience(batch, batch.numel(), episodes)


class Collector:
    """Rollouts for an agent, one after the other, each with its policy of that time.

    With several environments their rollouts are under way side by side, and are taken
    in turns. With `ahead`, the next rollout is under way while the agent learns from
    the last one. Either way a policy is a fixed number of updates old, however fast
    whoever is, so that a run still repeats itself bit for bit.
    """

    def __init__(self, envs: Sequence[TaskEnv], agent: Agent, ahead: bool) -> None:
        self._envs, self._agent, self._ahead = envs, agent, ahead
        self._rollouts = [Rollout(env) for env in envs]
        self._pool = ThreadPoolExecutor(len(envs), "manip-collect")
        self._under_way: deque[Future[Experience]] = deque()
        self._turn = 0

    def next(self) -> Experience:
        """The next rollout, as soon as it is there."""
        self._begin()
        found = self._under_way.popleft().result()
        if self._ahead:
            self._begin()
        return found

    def _begin(self) -> None:
        """Let every environment be under way."""
        while len(self._under_way) < len(self._envs):
            rollout = self._rollouts[self._turn % len(self._envs)]
            job = self._pool.submit(self._collect, rollout, self._agent.policy())
            self._under_way.append(job)
            self._turn += 1

    def _collect(self, rollout: Rollout, policy: TensorDictModuleBase) -> Experience:
        found = rollout.collect(policy, self._agent.rollout_length)
        return replace(found, batch=self._agent.process_rollout(policy, found.batch))

    def save_state(self) -> dict[str, Any]:
        """TaskBatch, episodes under way, and the rollouts that nobody has learned from."""
        waiting = [_plain(job.result()) for job in self._under_way]
        return {
            "envs": [env.batch.save_state() for env in self._envs],
            "trackers": [rollout.tracker.save_state() for rollout in self._rollouts],
            "turn": self._turn,
            "waiting": waiting,
        }

    def load_state(self, state: dict[str, Any]) -> None:
        """Put back what `save_state` gave.

        Raises:
            ValueError: the state is of other worlds.
        """
        saved = zip(state["envs"], state["trackers"], strict=True)
        for env, rollout, (worlds, tracker) in zip(
            self._envs, self._rollouts, saved, strict=True
        ):
            env.batch.load_state(worlds)
            rollout.tracker.load_state(tracker)
            rollout.state = env.observe()
        self._turn = state["turn"]
        self._under_way.clear()
        for plain in state["waiting"]:
            self._under_way.append(Future())
            self._under_way[-1].set_result(_experience(plain))


def _plain(found: Experience) -> dict[str, Any]:
    return {
        "batch": found.batch.to_dict(),
        "dimensions": found.batch.batch_dims,
        "steps": found.steps,
        "episodes": [asdict(episode) for episode in found.episodes],
    }


def _experience(plain: dict[str, Any]) -> Experience:
    batch = TensorDict(plain["batch"]).auto_batch_size_(plain["dimensions"])
    episodes = [Episode(**episode) for episode in plain["episodes"]]
    return Experience(batch, plain["steps"], episodes)
