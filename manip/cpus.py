"""The processor: its name, and the CPUs that this process may use."""

import os
import platform
import re
from pathlib import Path


def usable_cpus() -> int:
    """Number of CPUs that this process may use (its affinity mask, if it has one)."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def machine() -> str:
    """Name of the processor and number of usable CPUs, to state beside a wall time."""
    cpuinfo = Path("/proc/cpuinfo")
    text = cpuinfo.read_text() if cpuinfo.is_file() else ""
    model = re.search(r"^model name\s*: (.+)$", text, re.MULTILINE)
    name = model[1] if model else platform.processor() or platform.machine()
    return f"{name}, {usable_cpus()} CPU{'s' * (usable_cpus() > 1)}"
