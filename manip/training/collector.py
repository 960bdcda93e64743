"""Collect experience; episodes continue from one rollout to the next."""

from collections import deque
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import asdict, dataclass, replace
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase

from manip.agents.agent import Agent
from manip.envs.adapters.torchrl import TaskEnv
from manip.errors import UserError
from manip.evaluation.episodes import Episode, EpisodeTracker
from manip.rewards.reward_function import RewardFunction


@dataclass(frozen=True)
class Experience:
    """A rollout as the agent learns from it.

    Attributes:
        batch: what `Agent.process_rollout` returned.
        steps: control steps of the rollout, all environments together.
        episodes: episodes that ended in it.
        reward_terms: mean of each raw reward term over the rollout's steps.
    """

    batch: TensorDictBase
    steps: int
    episodes: list[Episode]
    reward_terms: list[float]


class Rollout:
    """Steps an environment with a policy; episodes continue across calls.

    torchrl.collectors.Collector cannot save and restore where the environments stand,
    which a run needs to resume exactly.
    """

    def __init__(self, env: TaskEnv) -> None:
        self._env = env
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

    def load(self, tracker: dict[str, Any]) -> None:
        """Restore the episodes under way, after the environments were restored."""
        self.tracker.load_state(tracker)
        self.state = self._env.observe()


class Collector:
    """Collect rollouts for an agent, each with its policy at the time it starts.

    Several environment batches are stepped side by side, and their rollouts taken in
    turns. With `ahead`, the next rollout is collected while the agent learns from the
    last one. In both cases a policy is a fixed number of updates old at any speed
    of the threads, so that a run repeats bit for bit.

    With `asynchronous`, the rollout that ends first is taken first, and the run does
    not repeat.

    Args:
        reward: computes the reward that the agent learns from, on the thread that
            collects.
    """

    def __init__(
        self,
        envs: Sequence[TaskEnv],
        agent: Agent,
        ahead: bool,
        reward: RewardFunction,
        asynchronous: bool = False,
    ) -> None:
        self._envs, self._agent, self._ahead = envs, agent, ahead
        self._asynchronous = asynchronous
        self._reward = reward
        self._rollouts = [Rollout(env) for env in envs]
        self._pool = ThreadPoolExecutor(len(envs), "manip-collect")
        self._pending: deque[Future[Experience]] = deque()
        self._turn = 0

    def next(self) -> Experience:
        """Wait for the next rollout and return it."""
        self._submit()
        if self._asynchronous:
            self._let_first_be_next()
        experience = self._pending.popleft().result()
        if self._ahead:
            self._submit()
        return experience

    def _let_first_be_next(self) -> None:
        """Turn the order of the environment batches to one whose rollout has ended."""
        wait(self._pending, return_when=FIRST_COMPLETED)
        place = next(i for i, job in enumerate(self._pending) if job.done())
        self._pending.rotate(-place)
        self._turn += place

    def close(self) -> None:
        """Wait for rollouts under way, and end the threads."""
        self._pool.shutdown(cancel_futures=True)

    def example(self) -> Experience:
        """An experience of zeros with the keys, shapes and dtypes of `next`'s."""
        policy = self._agent.policy()
        experience = self._rollouts[0].example(policy, self._agent.rollout_length)
        batch = self._agent.process_rollout(policy, experience.batch)
        return replace(experience, batch=batch)

    def _submit(self) -> None:
        """Start rollouts until every environment batch has one under way."""
        while len(self._pending) < len(self._envs):
            rollout = self._rollouts[self._turn % len(self._envs)]
            job = self._pool.submit(self._collect, rollout, self._agent.policy())
            self._pending.append(job)
            self._turn += 1

    def _collect(self, rollout: Rollout, policy: TensorDictModuleBase) -> Experience:
        experience = rollout.collect(policy, self._agent.rollout_length)
        _set_reward(experience.batch, self._reward)
        batch = self._agent.process_rollout(policy, experience.batch)
        return replace(experience, batch=batch)

    def save_state(self) -> dict[str, Any]:
        """Environments, episodes under way, and rollouts not yet learned from."""
        pending = [plain(job.result()) for job in self._pending]
        return {
            "envs": [env.batch.save_state() for env in self._envs],
            "trackers": [rollout.tracker.save_state() for rollout in self._rollouts],
            "turn": self._turn,
            "pending": pending,
        }

    def load_state(self, state: dict[str, Any]) -> None:
        """Restore what `save_state` returned.

        Raises:
            ValueError: the state is of other environments.
        """
        saved = zip(state["envs"], state["trackers"], strict=True)
        for env, rollout, (batch, tracker) in zip(
            self._envs, self._rollouts, saved, strict=True
        ):
            env.batch.load_state(batch)
            rollout.load(tracker)
        self._turn = state["turn"]
        self._pending.clear()
        for values in state["pending"]:
            self._pending.append(Future())
            self._pending[-1].set_result(_from_dict(values))


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


def plain(experience: Experience) -> dict[str, Any]:
    """An experience as plain values and tensors."""
    return {
        "batch": experience.batch.to_dict(),
        "dimensions": experience.batch.batch_dims,
        "steps": experience.steps,
        "episodes": [asdict(episode) for episode in experience.episodes],
        "reward_terms": experience.reward_terms,
    }


def _from_dict(values: dict[str, Any]) -> Experience:
    batch = TensorDict(values["batch"]).auto_batch_size_(values["dimensions"])
    episodes = [Episode(**episode) for episode in values["episodes"]]
    return Experience(batch, values["steps"], episodes, values["reward_terms"])
