"""Values, n-step transitions and n-step advantages of rollouts [N, T]."""

import torch
from tensordict import TensorDict, TensorDictBase
from torch import nn

from manip.errors import UserError


@torch.no_grad()
def add_values(batch: TensorDictBase, critic: nn.Module) -> TensorDictBase:
    """Write the critic's `state_value` of each step and of its successor.

    A successor's value is that of the next step's state, except where an episode or the
    rollout ends: there the critic evaluates the true successor.
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
    """Form transitions of up to n steps from a rollout [N, T], with the same keys.

    The reward is r_t + gamma r_{t+1} + ... over m steps: n, or fewer where the episode
    or the rollout ends before. `next` follows the last of these steps, and
    `steps_to_next_obs` [N, T, 1] is m, as TorchRL's value estimators expect. Unlike in
    torchrl.data.MultiStep, `terminated` is also that of the last step.
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
    env_ids = torch.arange(batch.shape[0]).unsqueeze(-1)
    following = {
        "observation": batch["next", "observation"][env_ids, last],
        "terminated": batch["next", "terminated"][env_ids, last],
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
    """Write `value_target` and `advantage`, of n rewards each, to a rollout [N, T].

        target = r_t + ... + gamma^(n-1) r_{t+n-1} + gamma^n V(s_{t+n})
        advantage = target - V(s_t)

    There are fewer rewards where the episode or the rollout ends before, and V is 0
    after a termination.
    """
    steps = n_step_transitions(batch, n, gamma)
    future = critic(steps["next"].select("observation"))["state_value"]
    alive = ~steps["next", "terminated"]
    discount = gamma ** steps["steps_to_next_obs"]
    target = steps["next", "reward"] + discount * alive * future
    batch.set("value_target", target)
    return batch.set("advantage", target - batch["state_value"])


def check_steps(n_step: int, rollout_length: int) -> None:
    """Refuse sums of more rewards than a rollout has steps.

    Raises:
        UserError: n_step is above rollout_length.
    """
    if n_step > rollout_length:
        raise UserError(
            f"n_step is {n_step}, but a rollout has {rollout_length} steps: set "
            f"rollout_length to {n_step} or more"
        )
