"""Keys of a rollout: what an environment and a policy leave for an algorithm.

A rollout is a TensorDict of shape [N, T]: T control steps of N environments. Step t of
an environment continues where step t - 1 stopped, also across rollouts, unless an
episode ended there; the step after an end is the first one of the next episode.

Keys, shapes, contents::

    observation          [N, T, D] float32      joined parts of the state
    <camera>_image       [N, T, H, W, C] uint8  one key a camera, if there are any
    action               [N, T, A] float32      what it did, in [-1, 1] before clipping
    action_log_prob      [N, T] float32         log pi(a, s), from on-policy algorithms
    expert_action        [N, T, A] float32      of the expert or teacher
    next, observation    [N, T, D] float32      the true successor, also at an end
    next, <camera>_image as above               of the successor
    next, reward         [N, T, 1] float32      reward of the step
    next, reward_terms   [N, T, K] float32      the task's raw reward terms
    next, measures       [N, T, M] float32      visible measures, if requested
    next, terminated     [N, T, 1] bool         the task failed: do not bootstrap
    next, truncated      [N, T, 1] bool         time is up: bootstrap
    next, done           [N, T, 1] bool         terminated or truncated
    next, success        [N, T, 1] bool         the task's success condition holds
"""

import torch
from tensordict import TensorDictBase
from torch import Tensor

CPU = torch.device("cpu")


def placed(batch: TensorDictBase, device: torch.device) -> TensorDictBase:
    """A rollout on a device; the same object if it is there already."""
    return batch if batch["observation"].device == device else batch.to(device)


def episode_starts(ended: Tensor, fresh: Tensor) -> Tensor:
    """Mark the first steps of episodes.

    Args:
        ended: [N, T] bool, steps at which an episode ended.
        fresh: [N] bool, environments whose first step begins an episode.

    Returns:
        [N, T] bool.
    """
    return torch.cat([fresh[:, None], ended[:, :-1]], 1)


def numbers_after(batch: TensorDictBase, key: str) -> Tensor:
    """Return ("next", key) [N, T, K]; K is 0 where the environment does not give it."""
    numbers = batch["next"].get(key, None)
    return batch["next", "reward"][..., :0] if numbers is None else numbers
