"""Check before a run that the memory it needs is available."""

import os
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from manip.agents.agent import Spaces
from manip.agents.registry import load_algorithm
from manip.agents.replay_columns import row_bytes
from manip.errors import UserError, one_line, out_of_memory
from manip.training.config import TrainConfig

CGROUP = Path("/sys/fs/cgroup")
"""Limits of the container that this process runs in (cgroup v2)."""


def check_memory(config: TrainConfig, spaces: Spaces) -> None:
    """Check that the replay buffer fits, before anything is allocated.

    A step needs at least its observation, action and next observation, as float32, and
    its images, as bytes.

    Raises:
        UserError: it does not fit.
    """
    capacity = getattr(config.agent, "buffer_size", 0)
    dims = spaces.observation_dim, spaces.action_dim
    copies = load_algorithm(config.algo).image_copies
    step = row_bytes(*dims, spaces.inputs.cameras, copies)
    _compare(capacity * step, allocatable_memory(), capacity)
    extra = config.steps if config.until else 0
    _compare(min(capacity, config.steps + extra) * step, available_memory(), capacity)


def _compare(needed: int, available: int, capacity: int) -> None:
    if needed > available:
        raise UserError(
            f"not enough memory: a replay buffer of {capacity:,} steps needs at least "
            f"{needed / 2**30:,.1f} GiB, and {available / 2**30:,.1f} GiB can be "
            "allocated: choose a smaller --agent.buffer-size"
        )


def allocatable_memory() -> int:
    """Bytes that this process may still allocate: under `ulimit -v`, and in one piece.

    Linux refuses a piece that is larger than memory and swap, even if most of it will
    not be used.
    """
    machine = _meminfo("MemTotal", "SwapTotal")
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit == resource.RLIM_INFINITY:
        return machine
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    return min(machine, max(0, limit - pages * os.sysconf("SC_PAGE_SIZE")))


def available_memory() -> int:
    """Bytes of memory that are free on this machine, or in this container."""
    return min(_meminfo("MemAvailable", "SwapFree"), _container_memory())


def _meminfo(*names: str) -> int:
    """The sum of entries of /proc/meminfo [bytes]."""
    lines = Path("/proc/meminfo").read_text().splitlines()
    kibibytes = {line.split(":")[0]: int(line.split()[1]) for line in lines}
    return sum(kibibytes[name] for name in names) * 1024


def _container_memory() -> int:
    """Bytes that the container's limit leaves; no limit is a very large number."""
    try:
        limit = int((CGROUP / "memory.max").read_text())
        used = int((CGROUP / "memory.current").read_text())
    except (OSError, ValueError):  # no container, or "max"
        return 2**63
    return max(0, limit - used)


@contextmanager
def memory_errors() -> Iterator[None]:
    """While inside, turn the errors of all allocators into `UserError`.

    Raises:
        UserError: Python, numpy, torch or another library could not allocate memory.
    """
    try:
        yield
    except UserError:
        raise
    except Exception as error:
        if not out_of_memory(error):
            raise
        raise UserError(f"not enough memory: {one_line(error)}") from error
