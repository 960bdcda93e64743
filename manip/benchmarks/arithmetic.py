"""Arithmetic that a learner's update cannot do without, and what a core can do of it.

Counted are the products of matrices, 2 n m k operations for [n, m] by [m, k]; biases,
activations, LayerNorm and Adam come on top and are not counted. A network of widths
w_0 ... w_L takes F = 2 B sum w_i w_{i+1} forward for B rows, F once more for the
gradient of its weights, and F without its first layer to carry the gradient down there.
"""

import time
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
import torch
from threadpoolctl import threadpool_limits

PRODUCTS = ((256, 128, 128), (1024, 1024, 1024))
"""Sizes n, m, k of the products that a core's peak is measured with."""


def sac_update(
    observation: int,
    action: int,
    hidden: Sequence[int],
    batch: int,
    actor_delay: int = 1,
) -> float:
    """Operations of a SAC update: critics each time, the actor every `actor_delay`.

    Critics: actor, twin targets and twin critics forward; the critics' weights and
    what leads there. Actor: actor and twin critics forward; both critics down to the
    action only; the actor's weights and what leads there.
    """
    actor = (observation, *hidden, 2 * action)
    critic = (observation + action, *hidden, 1)
    to_action = (action, *hidden, 1)
    critics = forward(actor, batch) + 2 * forward(critic, batch)
    critics += 2 * _trained(critic, batch)
    improvement = _trained(actor, batch)
    improvement += 2 * (forward(critic, batch) + forward(to_action, batch))
    return critics + improvement / actor_delay


def ppo_epoch(observation: int, action: int, hidden: Sequence[int], rows: int) -> float:
    """Operations of a pass of PPO over `rows` steps: actor and critic, both ways."""
    widths = (observation, *hidden, action), (observation, *hidden, 1)
    return sum(_trained(net, rows) for net in widths)


def forward(widths: Sequence[int], rows: int) -> float:
    """Operations of a network of these widths, forward."""
    return 2.0 * rows * sum(above * below for above, below in pairwise(widths))


def _trained(widths: Sequence[int], rows: int) -> float:
    return 3 * forward(widths, rows) - forward(widths[:2], rows)


def core_peak(seconds: float = 0.3) -> float:
    """Operations a second of one core in float32 products: the best of PRODUCTS.

    PyTorch's and numpy's BLAS both try, and the fastest of all repetitions counts: a
    peak is what the machine can do, whatever else runs on it.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    with threadpool_limits(1, user_api="blas"):
        rates = [_rate(size, make, seconds) for size in PRODUCTS for make in _MAKERS]
    torch.set_num_threads(before)
    return max(rates)


def _rate(size: tuple[int, int, int], make: "Maker", seconds: float) -> float:
    multiply, best, ends = make(*size), float("inf"), time.perf_counter() + seconds
    repeats = max(1, 2**26 // int(np.prod(size)))
    multiply()
    while (began := time.perf_counter()) < ends:
        for _ in range(repeats):
            multiply()
        best = min(best, time.perf_counter() - began)
    return 2.0 * float(np.prod(size)) * repeats / best


def _torch_product(n: int, m: int, k: int) -> Callable[[], object]:
    a, b, out = torch.randn(n, m), torch.randn(m, k), torch.empty(n, k)
    return lambda: torch.mm(a, b, out=out)


def _numpy_product(n: int, m: int, k: int) -> Callable[[], object]:
    rng = np.random.default_rng(0)
    a, b = (rng.random(shape, dtype=np.float32) for shape in ((n, m), (m, k)))
    out = np.empty((n, k), np.float32)
    return lambda: np.matmul(a, b, out=out)


Maker = Callable[[int, int, int], Callable[[], object]]
_MAKERS: tuple[Maker, ...] = (_torch_product, _numpy_product)
