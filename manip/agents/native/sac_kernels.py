"""SAC's gradients in native code, for a block of rows; equations in `sac.py`.

Threads share a batch block by block; the caller adds up the blocks' results. A row is
one transition: state s [O], action a [A], successor s' [O], reward, number of steps n
from s to s', and whether the episode terminated there.
"""

from typing import NamedTuple

import numpy as np

from manip.agents.native.mlp_kernels import (
    Layout,
    backward,
    backward_to_input,
    forward,
    tape_size,
    zeros_of,
)
from manip.agents.networks import MAX_LOG_STD, MIN_LOG_STD
from manip.compiled import fast_jit, fast_kernel

Array = np.ndarray

# log std = LOW + SPAN (tanh(raw) + 1) / 2
LOW, SPAN = np.float32(MIN_LOG_STD), np.float32(MAX_LOG_STD - MIN_LOG_STD)
ONE, TWO, HALF = np.float32(1), np.float32(2), np.float32(0.5)
LOG_2, LOG_2PI = np.float32(np.log(2)), np.float32(np.log(2 * np.pi))


class Nets(NamedTuple):
    """Flat parameters, their layout, and the losses' constants.

    actor: [P + 1], the last one is log(temperature); critics, targets: [C, Q].
    """

    actor: Array
    critics: Array
    targets: Array
    actor_layout: Layout
    critic_layout: Layout
    action_scale: Array
    gamma: float
    target_entropy: float


class Work(NamedTuple):
    """Workspace of a block of up to R rows, and its results.

    d_actor, d_critics: gradients summed over rows, in the parameters' layout; sums: [2]
    over rows of the loss and of log pi(a | s).
    """

    state: Array
    pair: Array
    d_pair: Array
    out: Array
    d_out: Array
    value: Array
    d_value: Array
    actor_tape: Array
    critic_tape: Array
    scratch: Array
    squashed: Array
    std: Array
    slope: Array
    log_prob: Array
    d_actor: Array
    d_critics: Array
    sums: Array


def work_for(nets: Nets, blocks: int, rows: int) -> Work:
    """Workspaces of blocks of up to `rows` rows, as arrays [blocks, ...]."""
    actions, critics = len(nets.action_scale), len(nets.critics)
    pair = nets.critic_layout.widths[0]
    widest = max(nets.actor_layout.widths.max(), nets.critic_layout.widths.max())
    shapes = {
        "state": (rows, pair - actions), "pair": (rows, pair),
        "d_pair": (critics, rows, pair), "out": (rows, 2 * actions),
        "d_out": (rows, 2 * actions), "value": (critics, rows, 1),
        "d_value": (critics, rows, 1),
        "actor_tape": (tape_size(nets.actor_layout, rows),),
        "critic_tape": (critics, tape_size(nets.critic_layout, rows)),
        "scratch": (2, rows * widest), "squashed": (rows, actions),
        "std": (rows, actions), "slope": (rows, actions), "log_prob": (rows,),
        "d_actor": nets.actor.shape, "d_critics": nets.critics.shape, "sums": (2,),
    }  # fmt: skip
    return Work(**zeros_of(shapes, blocks))


@fast_jit
def critic_gradients(nets: Nets, rows: Array, noise: Array, work: Work) -> None:
    """Write the gradients of sum over rows and critics of (Q_i(s, a) - y)^2 to `work`.

    Also writes that sum, to sums[0].

    Args:
        rows: [n, 2 O + A + 3] transitions; noise: [n, A] standard normal.
    """
    n = len(rows)
    size = work.pair.shape[1]
    state, pair, value = work.state[:n], work.pair[:n], work.value
    state[:] = rows[:, size : size + state.shape[1]]
    _act(nets, state, noise, pair, work)
    for i in range(len(nets.targets)):
        _value(nets.targets[i], nets, i, work, pair)
    target = work.log_prob  # y takes the place of log pi, row by row
    alpha = np.exp(nets.actor[-1])
    for r in range(n):
        # V(s') = min_i Q'_i(s', a') - alpha log pi(a' | s')
        future = value[:, r, 0].min() - alpha * work.log_prob[r]
        # y = r + gamma^n (1 - terminated) V(s'); r holds the n-step sum of rewards
        discount = np.float32(nets.gamma) ** rows[r, -2] * (ONE - rows[r, -1])
        target[r] = rows[r, -3] + discount * future
    pair[:] = rows[:, :size]
    work.sums[:] = 0
    for i in range(len(nets.critics)):
        tape, d_value = work.critic_tape[i], work.d_value[i, :n]
        _value(nets.critics[i], nets, i, work, pair)
        for r in range(n):
            error = value[i, r, 0] - target[r]  # d(error^2) / dQ = 2 error
            work.sums[0] += error * error
            d_value[r, 0] = TWO * error
        backward(
            nets.critics[i],
            nets.critic_layout,
            pair,
            tape,
            d_value,
            work.scratch,
            work.d_critics[i],
        )


@fast_jit
def actor_gradients(nets: Nets, rows: Array, noise: Array, work: Work) -> None:
    """Write the gradients of the actor's and the temperature's loss to `work`.

    Summed over rows. Also writes the sums of the actor's loss and of log pi(a | s).

    Args:
        rows: [n, 2 O + A + 3] transitions; noise: [n, A] standard normal.
    """
    n, states = len(rows), work.state.shape[1]
    state, pair, value = work.state[:n], work.pair[:n], work.value
    state[:] = rows[:, :states]
    _act(nets, state, noise, pair, work)
    for i in range(len(nets.critics)):
        _value(nets.critics[i], nets, i, work, pair)
    alpha = np.exp(nets.actor[-1])
    work.sums[:] = 0
    for r in range(n):
        # d(min_i Q_i) / dQ_i: 1 for the lowest critic, 0 for the others
        lower = value[:, r, 0].argmin()
        work.d_value[:, r, 0] = 0
        work.d_value[lower, r, 0] = ONE
        work.sums[0] += alpha * work.log_prob[r] - value[lower, r, 0]
        work.sums[1] += work.log_prob[r]
    for i in range(len(nets.critics)):
        backward_to_input(
            nets.critics[i],
            nets.critic_layout,
            work.critic_tape[i],
            work.d_value[i, :n],
            work.scratch,
            work.d_pair[i, :n],
        )
    _act_backward(nets, noise, alpha, states, work)
    d_out = work.d_out[:n]
    backward(
        nets.actor,
        nets.actor_layout,
        state,
        work.actor_tape,
        d_out,
        work.scratch,
        work.d_actor,
    )
    # d(-log(alpha) (log pi + target entropy)) / d(log alpha)
    work.d_actor[-1] = -(work.sums[1] + n * np.float32(nets.target_entropy))


@fast_kernel
def _value(params: Array, nets: Nets, i: int, work: Work, pair: Array) -> None:
    """Compute critic i's Q(s, a) into value[i]."""
    out = work.value[i, : len(pair)]
    forward(params, nets.critic_layout, pair, work.critic_tape[i], out)


@fast_kernel
def _act(nets: Nets, state: Array, noise: Array, pair: Array, work: Work) -> None:
    """Sample an action: write (s, a) to pair and log pi(a | s) to log_prob.

    a = scale tanh(u) with u = mean + std noise;
    log pi = log N(u) - sum log(scale (1 - tanh(u)^2)).
    """
    n, actions = noise.shape
    states = state.shape[1]
    out = work.out[:n]
    forward(nets.actor, nets.actor_layout, state, work.actor_tape, out)
    pair[:, :states] = state
    for r in range(n):
        log_prob = np.float32(0)
        for j in range(actions):
            spread, _ = _tanh(out[r, actions + j])
            log_std = LOW + SPAN * (spread + ONE) * HALF
            work.std[r, j] = np.exp(log_std)
            # d(log std) / d(raw)
            work.slope[r, j] = SPAN * HALF * (ONE - spread * spread)
            u = out[r, j] + work.std[r, j] * noise[r, j]
            squashed, log_slope = _tanh(u)
            work.squashed[r, j] = squashed
            pair[r, states + j] = nets.action_scale[j] * squashed
            # log N(u) = -1/2 (noise^2 + log 2 pi) - log std
            log_prob -= HALF * (noise[r, j] * noise[r, j] + LOG_2PI) + log_std
            log_prob -= log_slope + np.log(nets.action_scale[j])
        work.log_prob[r] = log_prob


@fast_kernel
def _tanh(u: float) -> tuple[float, float]:
    """Return tanh(u), and log(1 - tanh(u)^2) without cancellation.

    With e = exp(-2 |u|): tanh |u| = (1 - e) / (1 + e), and
    1 - tanh(u)^2 = 4 e / (1 + e)^2.
    """
    e = np.exp(-TWO * abs(u))
    tanh = (ONE - e) / (ONE + e)
    log_slope = TWO * (LOG_2 - abs(u) - np.log1p(e))
    return (tanh if u > 0 else -tanh), log_slope


@fast_kernel
def _act_backward(
    nets: Nets, noise: Array, alpha: float, states: int, work: Work
) -> None:
    """Write the gradient by the actor's outputs to d_out, from dQ/da in d_pair.

    Of alpha log pi - Q, with d(log pi)/du = 2 tanh(u), da/du = scale (1 - tanh(u)^2),
    du/d(log std) = std noise, and d(log pi)/d(log std) = -1 beside that by u.
    """
    n, actions = noise.shape
    for r in range(n):
        for j in range(actions):
            t = work.squashed[r, j]
            by_action = work.d_pair[:, r, states + j].sum()
            by_u = alpha * TWO * t
            by_u -= by_action * nets.action_scale[j] * (ONE - t * t)
            work.d_out[r, j] = by_u
            by_log_std = by_u * noise[r, j] * work.std[r, j] - alpha
            work.d_out[r, actions + j] = by_log_std * work.slope[r, j]
