"""Experience: a rollout, with what happened in it, as values that can be stored."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from statistics import fmean
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase

from manip.evaluation.episodes import Episode


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


def by_time(experience: Experience, parts: int) -> list[tuple[int, list[Episode]]]:
    """The episodes of a rollout, by the part of its control steps in which they ended.

    Args:
        experience: a rollout whose batch [N, T] may lack the ends of episodes, as that
            of an algorithm which learned while it collected.
        parts: number of parts of about equal length; fewer if there are fewer steps.

    Returns:
        control steps of all environments up to the end of each part, and its episodes;
        one part only if the batch does not say when episodes ended.
    """
    whole = [(experience.steps, experience.episodes)]
    done = experience.batch.get(("next", "done"), None)
    if done is None or parts == 1:
        return whole
    num_envs, length, _ = done.shape
    parts = min(parts, length)
    ended, env_ids = done.squeeze(-1).T.nonzero().T.tolist()
    if [episode.env_id for episode in experience.episodes] != env_ids:
        return whole  # of several collectors, one after another
    ends = [-(-length * part // parts) for part in range(parts + 1)]
    pairs = list(zip(ended, experience.episodes, strict=True))
    return [
        (num_envs * end, [episode for step, episode in pairs if start <= step < end])
        for start, end in pairwise(ends)
    ]


def joined(parts: Sequence[Experience]) -> Experience:
    """One experience of the environments of all parts, which have equal numbers."""
    if len(parts) == 1:
        return parts[0]
    terms = zip(*(part.reward_terms for part in parts), strict=True)
    return Experience(
        batch=torch.cat([part.batch for part in parts]),
        steps=sum(part.steps for part in parts),
        episodes=[episode for part in parts for episode in part.episodes],
        reward_terms=[fmean(values) for values in terms],
    )


def plain(experience: Experience) -> dict[str, Any]:
    """An experience as plain values and tensors."""
    return {
        "batch": experience.batch.to_dict(),
        "dimensions": experience.batch.batch_dims,
        "steps": experience.steps,
        "episodes": [asdict(episode) for episode in experience.episodes],
        "reward_terms": experience.reward_terms,
    }


def experience_of(values: dict[str, Any]) -> Experience:
    """The experience of what `plain` returned."""
    batch = TensorDict(values["batch"]).auto_batch_size_(values["dimensions"])
    episodes = [Episode(**episode) for episode in values["episodes"]]
    return Experience(batch, values["steps"], episodes, values["reward_terms"])
