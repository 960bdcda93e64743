"""Transitions over several steps, from rollouts."""

import torch
from tensordict import TensorDict, TensorDictBase


def n_step_transitions(batch: TensorDictBase, n: int, gamma: float) -> TensorDictBase:
    """Transitions of up to n steps out of a rollout [N, T], under the same keys.

    reward is r_t + gamma r_{t+1} + ... over the steps until n are taken, the episode
    ends or the rollout does; `next` is what follows the last of them, and
    `steps_to_next_obs` [N, T, 1] their number, as torchrl's value estimators know it.
    Unlike in torchrl.data.MultiStep, `terminated` is that of the last step, too.
    """
    reward = batch["next", "reward"].clone()
    going = ~batch["next", "done"]
    last = torch.arange(batch.shape[1]).expand(batch.shape).clone()
    for k in range(1, min(n, batch.shape[1])):
        more = going[:, :-k]
        reward[:, :-k] += gamma**k * more * batch["next", "reward"][:, k:]
        last[:, :-k] += more.squeeze(-1)
        going[:, :-k] = more & ~batch["next", "done"][:, k:]
        going[:, -k:] = False
    steps = last - torch.arange(batch.shape[1]) + 1
    worlds = torch.arange(batch.shape[0]).unsqueeze(-1)
    following = {
        "observation": batch["next", "observation"][worlds, last],
        "terminated": batch["next", "terminated"][worlds, last],
        "reward": reward,
    }
    return TensorDict(
        {
            "observation": batch["observation"],
            "action": batch["action"],
            "steps_to_next_obs": steps.unsqueeze(-1),
            "next": TensorDict(following, batch.shape),
        },
        batch.shape,
    )
