"""Count the floating-point operations of an update, and measure a core's peak.

Only matrix products count: 2 n m k operations for [n, m] by [m, k]. Biases,
activations, LayerNorm and Adam are not counted. A network with layer widths w_0 ...
w_L takes F = 2 B sum w_i w_{i+1} operations forward for B rows, F for the gradient of
its weights, and F without the first layer to propagate the gradient to that layer.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise

import numpy as np
import torch
from threadpoolctl import threadpool_limits

PRODUCTS = ((256, 128, 128), (1024, 1024, 1024))
"""Sizes n, m, k of the products that measure a core's peak."""


def sac_update(
    observation: int,
    action: int,
    hidden: Sequence[int],
    batch: int,
    actor_delay: int = 1,
) -> float:
    """Operations of a SAC update; the actor is updated every `actor_delay` updates.

    Critic update: actor, twin target critics and twin critics forward; backward to the
    critics' weights. Actor update: actor and twin critics forward; backward through
    the critics to the action only, and to the actor's weights.
    """
    actor = (observation, *hidden, 2 * action)
    critic = (observation + action, *hidden, 1)
    to_action = (action, *hidden, 1)
    critic_update = forward(actor, batch) + 2 * forward(critic, batch)
    critic_update += 2 * _trained(critic, batch)
    actor_update = _trained(actor, batch)
    actor_update += 2 * (forward(critic, batch) + forward(to_action, batch))
    return critic_update + actor_update / actor_delay


def ppo_epoch(observation: int, action: int, hidden: Sequence[int], rows: int) -> float:
    """Operations of a PPO epoch over `rows` steps: actor and critic, both passes."""
    widths = (observation, *hidden, action), (observation, *hidden, 1)
    return sum(_trained(net, rows) for net in widths)


def forward(widths: Sequence[int], rows: int) -> float:
    """Operations of a forward pass through layers of these widths."""
    return 2.0 * rows * sum(inputs * outputs for inputs, outputs in pairwise(widths))


def _trained(widths: Sequence[int], rows: int) -> float:
    """Forward and backward: 3 F, less the first layer's share of the third F."""
    return 3 * forward(widths, rows) - forward(widths[:2], rows)


def core_peak(seconds: float = 0.3) -> float:
    """Measure the operations per second of one core in float32 matrix products.

    The best repetition of PyTorch's and NumPy's BLAS counts, because the peak is what
    the core can do without other work.
    """
    with _one_torch_thread(), threadpool_limits(1, user_api="blas"):
        return max(_rate(size, make, seconds) for size in PRODUCTS for make in _MAKERS)


@contextmanager
def _one_torch_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _rate(size: tuple[int, int, int], make: "Maker", seconds: float) -> float:
    multiply, best = make(*size), float("inf")
    repeats = max(1, 2**26 // int(np.prod(size)))
    multiply()
    start, end = time.perf_counter(), time.perf_counter() + seconds
    while best == float("inf") or start < end:
        for _ in range(repeats):
            multiply()
        best = min(best, time.perf_counter() - start)
        start = time.perf_counter()
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
