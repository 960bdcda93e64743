"""PPO's gradients in native code, for a block of rows; equations in `ppo.py`.

A row is one sample: state s [O] (normalised), action a [A], log pi_old(a | s),
advantage (normalised) and value target R.
"""

from typing import NamedTuple

import numpy as np

from manip.agents.native.mlp_kernels import (
    Layout,
    backward,
    forward,
    tape_size,
    zeros_of,
)
from manip.compiled import fast_jit, fast_kernel

Array = np.ndarray

ONE, TWO, HALF = np.float32(1), np.float32(2), np.float32(0.5)
LOG_2PI = np.float32(np.log(2 * np.pi))


class Nets(NamedTuple):
    """Flat parameters, their layout, and the loss's constants.

    params: [P + A + Q] of actor, log standard deviations (of a / action_scale), critic.
    log_std_at: P. clip: eps.
    """

    params: Array
    actor_layout: Layout
    critic_layout: Layout
    log_std_at: int
    action_scale: Array
    clip: float
    critic_coefficient: float


class Work(NamedTuple):
    """Workspace of a block of up to R rows, and its results.

    grads: [P + A + Q], gradients summed over rows; sums: [4] over rows of objective,
    critic loss, KL divergence (Schulman's estimate (rho - 1) - log rho,
    joschu.net/blog/kl-approx.html), and number of rows outside the clip range.
    """

    state: Array
    mean: Array
    d_mean: Array
    std: Array
    value: Array
    d_value: Array
    actor_tape: Array
    critic_tape: Array
    scratch: Array
    grads: Array
    sums: Array


def work_for(nets: Nets, blocks: int, rows: int) -> Work:
    """Workspaces of blocks of up to `rows` rows, as arrays [blocks, ...]."""
    actions = len(nets.action_scale)
    widest = max(nets.actor_layout.widths.max(), nets.critic_layout.widths.max())
    shapes = {
        "state": (rows, nets.actor_layout.widths[0]), "mean": (rows, actions),
        "d_mean": (rows, actions), "std": (actions,),
        "value": (rows, 1), "d_value": (rows, 1),
        "actor_tape": (tape_size(nets.actor_layout, rows),),
        "critic_tape": (tape_size(nets.critic_layout, rows),),
        "scratch": (2, rows * widest), "grads": nets.params.shape, "sums": (4,),
    }  # fmt: skip
    return Work(**zeros_of(shapes, blocks))


@fast_jit
def ppo_gradients(nets: Nets, rows: Array, work: Work) -> None:
    """Write the gradients of the clipped objective and the critic's loss to `work`.

    Summed over rows [n, O + A + 3]. Leaves out the entropy bonus, which does not depend
    on rows.
    """
    n, states = len(rows), work.state.shape[1]
    at, end = nets.log_std_at, nets.log_std_at + len(nets.action_scale)
    state, mean, value = work.state[:n], work.mean[:n], work.value[:n]
    state[:] = rows[:, :states]
    actor, critic = nets.params[:at], nets.params[end:]
    forward(actor, nets.actor_layout, state, work.actor_tape, mean)
    forward(critic, nets.critic_layout, state, work.critic_tape, value)
    work.sums[:] = 0
    work.grads[at:end] = 0
    work.std[:] = np.exp(nets.params[at:end])
    # sum of log deviations of the action: log(action_scale std)
    log_scale = np.sum(nets.params[at:end] + np.log(nets.action_scale))
    for r in range(n):
        unit = work.d_mean[r]
        action = rows[r, states : states + len(unit)]
        unit[:] = (action / nets.action_scale - mean[r]) / work.std
        _actor_row(nets, rows[r], log_scale, unit, work)
        error = value[r, 0] - rows[r, -1]
        weight = np.float32(nets.critic_coefficient)  # c_V (V(s) - R)^2
        work.sums[1] += weight * error * error
        work.d_value[r, 0] = weight * TWO * error
    backward(
        actor,
        nets.actor_layout,
        state,
        work.actor_tape,
        work.d_mean[:n],
        work.scratch,
        work.grads[:at],
    )
    backward(
        critic,
        nets.critic_layout,
        state,
        work.critic_tape,
        work.d_value[:n],
        work.scratch,
        work.grads[end:],
    )


@fast_kernel
def _actor_row(
    nets: Nets, row: Array, log_scale: float, unit: Array, work: Work
) -> None:
    """Add one sample's objective, and its gradients by log deviations and mean.

    Args:
        unit: [A], the action in standard deviations from the mean; becomes the gradient
            by the actor's output.
    """
    # log N(a) = -1/2 sum (unit^2 + log 2 pi) - sum log deviation
    log_prob = -HALF * np.sum(unit * unit + LOG_2PI) - log_scale
    log_ratio, advantage = log_prob - row[-3], row[-2]
    ratio, clip = np.exp(log_ratio), np.float32(nets.clip)
    bounded = min(max(ratio, ONE - clip), ONE + clip)
    clipped = bounded * advantage < ratio * advantage
    # slope: d(-min(rho A, clip(rho) A)) / d(log pi), as d rho = rho d(log pi)
    slope = np.float32(0) if clipped else -ratio * advantage
    work.sums[0] -= min(bounded * advantage, ratio * advantage)
    work.sums[2] += ratio - ONE - log_ratio  # KL divergence
    work.sums[3] += ratio != bounded
    for j in range(len(unit)):
        # d(log pi) / d(log std) = unit^2 - 1, d(log pi) / d(mean) = unit / std
        work.grads[nets.log_std_at + j] += slope * (unit[j] * unit[j] - ONE)
        unit[j] *= slope / work.std[j]
