"""Random batches on which errors of native gradients show."""

import torch
from torch import Tensor
from torchrl.modules import IndependentNormal

from manip.agents.networks import Actor

NEAR = 0.005
"""Distance of ratios rho from the clip range's ends, as a fraction of eps."""

MIN_NEAR = 1e-4
"""Least such distance: well above rounding."""

MIN_RATIO = 0.05
"""Least ratio rho of a probe row; wide clip ranges have no lower end."""


def sac_probe(actor: Actor, batch: int, seed: int) -> Tensor:
    """Transitions [B, 2 O + A + 3] of one to three steps; a fifth ends in termination.

    See `manip.agents.off_policy.rows_of` for the columns.
    """
    draw = torch.Generator().manual_seed(seed)
    states, actions = actor.observation_dim, len(actor.action_scale)
    rows = torch.randn(batch, 2 * states + actions + 3, generator=draw)
    rows[:, states : states + actions].tanh_()
    rows[:, -2] = 1 + torch.arange(batch) % 3
    rows[:, -1] = torch.arange(batch) % 5 == 4
    return rows


@torch.no_grad()
def ppo_probe(actor: Actor, clip: float, batch: int, seed: int) -> Tensor:
    """Samples [B, O + A + 3] of the actor; old log-probabilities make chosen ratios.

    See `manip.agents.native.ppo_gradients.rows_of` for the columns.

    Args:
        clip: eps.
    """
    draw = torch.Generator().manual_seed(seed)
    state = torch.randn(batch, actor.observation_dim, generator=draw)
    mean, std = actor(state)
    action = mean + std * torch.randn(mean.shape, generator=draw)
    log_prob = IndependentNormal(mean, std).log_prob(action).unsqueeze(-1)
    ratios = _ratios(clip)
    ratio = ratios.repeat(-(-batch // len(ratios)))[:batch, None]
    advantage_and_target = torch.randn(batch, 2, generator=draw)
    return torch.cat([state, action, log_prob - ratio.log(), advantage_and_target], -1)


def entropy_probe(actor: Actor, clip: float, seed: int) -> Tensor:
    """One sample without advantage: only the entropy bonus moves the deviations."""
    rows = ppo_probe(actor, clip, 1, seed)
    rows[:, -2] = 0
    return rows


def _ratios(clip: float) -> Tensor:
    """Ratios rho inside and outside the clip range, and near its ends."""
    near = max(NEAR * clip, MIN_NEAR)
    above = [clip / 2, clip - near, clip + near, 1.5 * clip]
    ratios = 1 + torch.tensor([0.0, *above, *(-offset for offset in above)])
    return ratios[ratios > MIN_RATIO]
