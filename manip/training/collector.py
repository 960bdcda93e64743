"""Collect experience; episodes continue from one rollout to the next."""

from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import replace
from typing import Any, Literal, Protocol

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from manip.agents.agent import Agent
from manip.envs.adapters.torchrl import TaskEnv
from manip.errors import UserError
from manip.evaluation.episodes import EpisodeTracker
from manip.rewards.reward_function import RewardFunction
from manip.training.experience import Experience, experience_of, joined, plain


class RolloutSource(Protocol):
    """Environments that a policy steps, here or in another process.

    Attributes:
        messages: lines for people to read; the reader removes them.
    """

    messages: deque[str]

    def collect(self, policy: TensorDictModuleBase, length: int) -> Experience:
        """Step all environments `length` times; the batch is [N, T]."""

    def example(self, policy: TensorDictModuleBase, length: int) -> Experience:
        """An experience of zeros with the keys, shapes and dtypes of `collect`'s."""

    def save_state(self) -> dict[str, Any]:
        """State of the environments ("env") and of the episodes under way ("tracker").

        It is that after the latest `collect`.
        """

    def load_state(self, state: dict[str, Any]) -> None:
        """Restore what `save_state` returned."""


class Rollout:
    """Steps an environment with a policy; episodes continue across calls.

    torchrl.collectors.Collector cannot save and restore where the environments stand,
    which a run needs to resume exactly.
    """

    def __init__(self, env: TaskEnv) -> None:
        self._env = env
        self.messages: deque[str] = deque()
        self.tracker = EpisodeTracker(env.batch_size[0])
        self.state = env.reset()

    def collect(self, policy: TensorDictModuleBase, length: int) -> Experience:
        """Step all environments `length` times; the batch is [N, T]."""
        steps, episodes = [], []
        for _ in range(length):
            step, self.state = self._env.step_and_maybe_reset(policy(self.state))
            episodes += self.tracker.update(step["next"])
            steps.append(step)
        batch: TensorDictBase = torch.stack(steps, 1)
        terms = batch["next", "reward_terms"].mean((0, 1)).tolist()
        return Experience(batch, batch.numel(), episodes, terms)

    def example(self, policy: TensorDictModuleBase, length: int) -> Experience:
        """An experience of zeros with the keys, shapes and dtypes of `collect`'s."""
        step = policy(self._env.fake_tensordict())
        batch: TensorDictBase = torch.stack([step] * length, 1)
        terms = [0.0] * batch["next", "reward_terms"].shape[-1]
        return Experience(batch, batch.numel(), [], terms)

    def save_state(self) -> dict[str, Any]:
        """State of the environments, and of the episodes under way."""
        env, tracker = self._env.batch.save_state(), self.tracker.save_state()
        return {"env": env, "tracker": tracker}

    def load_state(self, state: dict[str, Any]) -> None:
        """Restore what `save_state` returned.

        Raises:
            ValueError: the state is of other environments.
        """
        self._env.batch.load_state(state["env"])
        self.tracker.load_state(state["tracker"])
        self.state = self._env.observe()


Order = Literal["turns", "first", "together"]
"""How rollouts of several sources are taken: in turns; the one that ends first first;
or all at once, joined to one, collected with the same weights."""


class Collector:
    """Collect rollouts for an agent, each with its policy at the time it starts.

    With `ahead`, the next rollout is collected while the agent learns from the last
    one. A policy is a fixed number of updates old at any speed of the threads, so that
    a run repeats bit for bit, unless the order is "first".

    Args:
        sources: groups of environments, stepped side by side.
        agent: gives the policies.
        ahead: collect while the agent learns.
        reward: computes the reward that the agent learns from, on the thread that
            collects.
        order: in which the rollouts of the sources are taken.
    """

    def __init__(
        self,
        sources: Sequence[RolloutSource],
        agent: Agent,
        ahead: bool,
        reward: RewardFunction,
        order: Order = "turns",
    ) -> None:
        self._sources, self._agent, self._ahead = sources, agent, ahead
        self._order, self._reward = order, reward
        self._under_way = 1 if order == "together" else len(sources)
        threads = len(sources) + (order == "together")  # one joins those of the others
        self._pool = ThreadPoolExecutor(threads, "manip-collect")
        self._pending: deque[Future[Experience]] = deque()
        self._turn = 0

    def next(self) -> Experience:
        """Wait for the next rollout and return it."""
        self._submit()
        if self._order == "first":
            self._let_first_be_next()
        experience = self._pending.popleft().result()
        if self._ahead:
            self._submit()
        return experience

    def messages(self) -> Iterator[str]:
        """Lines about the sources, new since the last call."""
        for source in self._sources:
            while source.messages:
                yield source.messages.popleft()

    def _let_first_be_next(self) -> None:
        """Turn the order of the sources to one whose rollout has ended."""
        wait(self._pending, return_when=FIRST_COMPLETED)
        place = next(i for i, job in enumerate(self._pending) if job.done())
        self._pending.rotate(-place)
        self._turn += place

    def close(self) -> None:
        """Wait for rollouts under way, and end the threads."""
        self._pool.shutdown(cancel_futures=True)

    def example(self) -> Experience:
        """An experience of zeros with the keys, shapes and dtypes of `next`'s."""
        policy, length = self._agent.policy(), self._agent.rollout_length
        sources = self._sources if self._order == "together" else self._sources[:1]
        experience = joined([source.example(policy, length) for source in sources])
        batch = self._agent.process_rollout(policy, experience.batch)
        return replace(experience, batch=batch)

    def _submit(self) -> None:
        """Start rollouts until as many as there may be are under way."""
        while len(self._pending) < self._under_way:
            self._pending.append(self._start())
            self._turn += 1

    def _start(self) -> Future[Experience]:
        if self._order == "together":
            policies = [self._agent.policy() for _ in self._sources]
            return self._pool.submit(self._collect_together, policies)
        source = self._sources[self._turn % len(self._sources)]
        return self._pool.submit(self._collect, source, self._agent.policy())

    def _collect(
        self, source: RolloutSource, policy: TensorDictModuleBase
    ) -> Experience:
        experience = source.collect(policy, self._agent.rollout_length)
        return self._processed(policy, experience)

    def _collect_together(self, policies: Sequence[TensorDictModuleBase]) -> Experience:
        """Step all sources side by side, each with exploration noise of its own."""
        jobs = [
            self._pool.submit(source.collect, policy, self._agent.rollout_length)
            for source, policy in zip(self._sources, policies, strict=True)
        ]
        return self._processed(policies[0], joined([job.result() for job in jobs]))

    def _processed(
        self, policy: TensorDictModuleBase, experience: Experience
    ) -> Experience:
        _set_reward(experience.batch, self._reward)
        batch = self._agent.process_rollout(policy, experience.batch)
        return replace(experience, batch=batch)

    def save_state(self) -> dict[str, Any]:
        """Environments, episodes under way, and rollouts not yet learned from."""
        pending = [plain(job.result()) for job in self._pending]
        states = [source.save_state() for source in self._sources]
        return {
            "envs": [state["env"] for state in states],
            "trackers": [state["tracker"] for state in states],
            "turn": self._turn,
            "pending": pending,
        }

    def load_state(self, state: dict[str, Any]) -> None:
        """Restore what `save_state` returned.

        Raises:
            ValueError: the state is of other environments.
        """
        saved = zip(state["envs"], state["trackers"], strict=True)
        for source, (env, tracker) in zip(self._sources, saved, strict=True):
            source.load_state({"env": env, "tracker": tracker})
        self._turn = state["turn"]
        self._pending.clear()
        for values in state["pending"]:
            self._pending.append(Future())
            self._pending[-1].set_result(experience_of(values))


def _set_reward(batch: TensorDictBase, reward: RewardFunction) -> None:
    """Replace the reward [N, T, 1] of a rollout.

    Raises:
        UserError: the function returns another shape, or numbers that are not finite
            or not real.
    """
    value, expected = reward(batch), batch["next", "reward"]
    if not isinstance(value, torch.Tensor) or value.shape != expected.shape:
        shape = list(getattr(value, "shape", ()))
        raise UserError(
            f"the reward function returned {type(value).__name__} {shape}, not a "
            f"tensor {list(expected.shape)}"
        )
    if value.is_complex() or not value.isfinite().all():
        raise UserError(
            "the reward function returned numbers that are not finite or not real"
        )
    batch["next", "reward"] = value.detach().to(expected.dtype)
