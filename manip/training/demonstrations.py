"""Learn from a data set (`--dataset`): rows to clone, or demonstrations for SAC."""

from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModuleBase

from manip.agents.agent import Agent
from manip.agents.registry import algorithm_names, load_algorithm
from manip.data.datasets import read_dataset
from manip.data.restored import restored
from manip.data.stored_episode import Recording, StoredEpisode
from manip.envs.adapters.torchrl import TaskEnv
from manip.envs.backends.native_batch import NativeBatch
from manip.envs.make_batch import make_batch
from manip.envs.task_batch import TaskBatch
from manip.errors import UserError
from manip.evaluation.episodes import EpisodeTracker
from manip.training.collector import RolloutSource
from manip.training.config import TrainConfig
from manip.training.experience import Experience

RESTORED_AT_ONCE = 128
"""States whose observations are computed at once."""


def check_dataset(config: TrainConfig) -> None:
    """Raise `UserError` if the options do not fit a data set, where there is one."""
    algorithm = load_algorithm(config.algo)
    if config.dataset is None:
        return
    if not algorithm.takes_datasets:
        able = [n for n in algorithm_names() if load_algorithm(n).takes_datasets]
        raise UserError(
            f"{config.algo} takes no --dataset: choose one of {', '.join(able)}"
        )
    if config.teacher is not None:
        raise UserError("--dataset and --teacher both say what to imitate: choose one")
    if not algorithm.imitates and config.observe == "cameras":
        raise UserError(f"{config.algo} takes no --dataset with --observe cameras")


def dataset_of(config: TrainConfig, batch: TaskBatch) -> list[StoredEpisode]:
    """The episodes of a run's data set, with observations as the run's.

    Raises:
        UserError: there is none, it is damaged, or of another task, arm, controller,
            observation or reward.
    """
    path = Path(str(config.dataset))
    recording, episodes = read_dataset(path)
    try:
        _check_recording(config, recording, batch)
        if not recording.observation:
            episodes = _restored(config, batch, episodes)
        for episode in episodes:
            _check_widths(config, batch, episode)
    except UserError as error:
        raise UserError(f"--dataset {path}: {error}") from error
    return episodes


def _check_recording(
    config: TrainConfig, recording: Recording, batch: TaskBatch
) -> None:
    own = recording.observation
    task = config.task if own else batch.task.robosuite_name
    expected = {"task": task, "robot": config.robot, "controller": config.controller}
    for name, value in (*expected.items(), ("control_freq", config.control_freq)):
        if getattr(recording, name) != value:
            raise UserError(f"its {name} is {getattr(recording, name)}, not {value}")
    if own:
        vector = [p for p in recording.spec.parts if p.role != "camera"]
        wanted = [p for p in batch.observation_spec.parts if p.role != "camera"]
        if vector != wanted:
            raise UserError("its observation is not that of this run")
    imitates = load_algorithm(config.algo).imitates
    if not imitates and (config.reward != recording.reward or config.reward_weights):
        raise UserError(
            f"its rewards are {recording.reward!r} with the task's own weights: leave "
            "out --reward and --reward-weights"
        )


def _restored(
    config: TrainConfig, batch: TaskBatch, episodes: list[StoredEpisode]
) -> list[StoredEpisode]:
    if config.observe == "cameras":
        raise UserError("another program recorded it: its images are not used")
    engine = make_batch(batch.task, RESTORED_AT_ONCE, robot=config.robot_config)
    if not isinstance(engine, NativeBatch):
        raise UserError(f"{config.task} does not run on the batch engine")
    return [restored(engine, episode) for episode in episodes]


def _check_widths(
    config: TrainConfig, batch: TaskBatch, episode: StoredEpisode
) -> None:
    widths = episode.observation.shape[1], episode.action.shape[1]
    if widths != (batch.observation_spec.dim, batch.action_dim):
        raise UserError(
            f"observation and action have {widths[0]} and {widths[1]} numbers, not "
            f"{batch.observation_spec.dim} and {batch.action_dim}"
        )
    for part in batch.cameras.parts:
        images = episode.images.get(part.name)
        if images is None or images.shape[1:] != part.shape:
            raise UserError(
                f"it has no images {part.name} of shape {[*part.shape]}: record them "
                "with --cameras and --image-size, or set --image-size"
            )


class DatasetRows:
    """A source of rollouts: the steps of a data set, in random order, labelled.

    Every step is given once before any is given again. Nothing is simulated.

    Args:
        episodes: of the data set.
        num_envs: N, so that rollouts have the size of simulated ones.
        terms: number of reward terms, which are not known.
        seed: of the order.
    """

    def __init__(
        self,
        episodes: Sequence[StoredEpisode],
        num_envs: int,
        terms: int,
        seed: int,
    ) -> None:
        self.messages: deque[str] = deque()
        self._num_envs, self._terms, self._seed = num_envs, terms, seed
        self._rows = _rows(episodes)
        self._position = 0

    def collect(self, policy: TensorDictModuleBase, length: int) -> Experience:
        """The next N x T steps; the batch is [N, T], and the policy does not act."""
        count, size = self._num_envs * length, len(self._rows)
        numbers = np.arange(self._position, self._position + count)
        self._position += count
        chosen = np.empty(count, np.int64)
        for epoch in np.unique(numbers // size):
            of_epoch = numbers // size == epoch
            order = np.random.default_rng([self._seed, int(epoch)]).permutation(size)
            chosen[of_epoch] = order[numbers[of_epoch] % size]
        batch = self._rows[torch.from_numpy(chosen)].reshape(self._num_envs, length)
        return Experience(batch, count, [], [0.0] * self._terms)

    def example(self, policy: TensorDictModuleBase, length: int) -> Experience:
        """An experience of zeros with the keys, shapes and dtypes of `collect`'s."""
        rows = torch.zeros_like(self._rows[:1])
        batch = rows.expand(self._num_envs * length).clone()
        shaped = batch.reshape(self._num_envs, length)
        return Experience(shaped, shaped.numel(), [], [0.0] * self._terms)

    def save_state(self) -> dict[str, Any]:
        """The position in the data set; no episodes are under way."""
        tracker = EpisodeTracker(self._num_envs).save_state()
        return {"env": {"position": self._position}, "tracker": tracker}

    def load_state(self, state: dict[str, Any]) -> None:
        """Restore what `save_state` returned.

        Raises:
            ValueError: the position is negative.
        """
        if state["env"]["position"] < 0:
            raise ValueError("the position in the data set is negative")
        self._position = int(state["env"]["position"])


def _rows(episodes: Sequence[StoredEpisode]) -> TensorDict:
    """All steps [S]: observation, images, expert_action and the reward after them."""

    def joined(arrays: Sequence[np.ndarray]) -> torch.Tensor:
        return torch.from_numpy(np.concatenate(arrays))

    rows = {
        "observation": joined([e.observation[:-1] for e in episodes]),
        "expert_action": joined([e.label for e in episodes]),
        **{
            name: joined([e.images[name][:-1] for e in episodes])
            for name in episodes[0].images
        },
    }
    size = len(rows["expert_action"])
    reward = joined([e.reward for e in episodes])[:, None]
    following = TensorDict({"reward": reward}, [size])
    return TensorDict({**rows, "next": following}, [size])


def rollouts_of(episodes: Sequence[StoredEpisode]) -> list[TensorDict]:
    """Episodes as rollouts [1, T] that an off-policy algorithm can store."""
    return [_rollout(episode) for episode in episodes]


def _rollout(episode: StoredEpisode) -> TensorDict:
    steps = episode.steps
    ends = torch.zeros(1, steps, 1, dtype=torch.bool)
    ends[:, -1] = True
    after = {
        "observation": torch.from_numpy(episode.observation[None, 1:]),
        "reward": torch.from_numpy(episode.reward[None, :, None]),
        "terminated": ends & episode.terminated,
        "done": ends,
    }
    return TensorDict(
        {
            "observation": torch.from_numpy(episode.observation[None, :-1]),
            "action": torch.from_numpy(episode.action[None]),
            "next": TensorDict(after, [1, steps]),
        },
        [1, steps],
    )


def use_dataset(
    config: TrainConfig, agent: Agent, envs: Sequence[TaskEnv]
) -> list[RolloutSource]:
    """Give a run's data set to its agent.

    Returns:
        The sources of its rollouts, if they are the data set's instead of simulated.
    """
    if config.dataset is None:
        return []
    batch = envs[0].batch
    episodes = dataset_of(config, batch)
    if not agent.imitates:
        agent.add_demonstrations(rollouts_of(episodes))
        return []
    terms = len(batch.reward_names)
    return [DatasetRows(episodes, config.num_envs, terms, config.seed)]
