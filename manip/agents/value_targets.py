"""Values and transitions over several steps, from rollouts."""

import torch
from tensordict import TensorDict, TensorDictBase
from torch import nn


@torch.no_grad()
def add_values(batch: TensorDictBase, critic: nn.Module) -> TensorDictBase:
    """Write state_value, now and next, of a rollout [N, T].

    The value of a successor is that of the next step's state, except where an episode
    or the rollout ends: there the true successor is valued.
    """
    value = critic(batch.select("observation"))["state_value"]
    following = torch.empty_like(value)
    following[:, :-1] = value[:, 1:]
    ends = batch["next", "done"].squeeze(-1).clone()
    ends[:, -1] = True
    last = batch["next"].select("observation")[ends]
    following[ends] = critic(last)["state_value"]
    batch.set("state_value", value)
    return batch.set(("next", "state_value"), following)


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


@torch.no_grad()
def n_step_advantages(
    batch: TensorDictBase, n: int, gamma: float, critic: nn.Module
) -> TensorDictBase:
    """Write value_target and advantage from n rewards each to a rollout [N, T].

    The target is r_t + ... + gamma^(n-1) r_{t+n-1} + gamma^n V(s_{t+n}), with fewer
    rewards where the episode or the rollout ends before, and no V after a termination;
    the advantage is the target less `state_value`.
    """
    steps = n_step_transitions(batch, n, gamma)
    future = critic(steps["next"].select("observation"))["state_value"]
    alive = ~steps["next", "terminated"]
    discount = gamma ** steps["steps_to_next_obs"]
    target = steps["next", "reward"] + discount * alive * future
    batch.set("value_target", target)
    return batch.set("advantage", target - batch["state_value"])
