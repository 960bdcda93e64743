"""The processor: how much of it this process may use, and its name."""

import os
import platform
import re
from pathlib import Path


def usable_cpus() -> int:
    """CPUs this process may run on (its affinity mask where the system has one)."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def machine() -> str:
    """Processor and usable CPUs: what a wall time was taken on."""
    cpuinfo = Path("/proc/cpuinfo")
    said = cpuinfo.read_text() if cpuinfo.is_file() else ""
    model = re.search(r"^model name\s*: (.+)$", said, re.MULTILINE)
    name = model[1] if model else platform.processor() or platform.machine()
    return f"{name}, {usable_cpus()} CPU{'s' * (usable_cpus() > 1)}"
