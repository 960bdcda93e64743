"""The processor: its name, and the CPUs that this process may use."""

import os
import platform
import re
from pathlib import Path

ZEN_4 = (*range(0x10, 0x20), *range(0x60, 0xB0))
"""Models of AMD's family 19h (25) that are Zen 4; the others are Zen 3 (Linux,
arch/x86/kernel/cpu/amd.c, bsp_init_amd)."""
GENERATIONS = {"25": "Zen 3", "26": "Zen 5"}
"""Family -> generation of AMD's processors; `ZEN_4` are exceptions."""


def usable_cpus() -> int:
    """Number of CPUs that this process may use (its affinity mask, if it has one)."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def machine() -> str:
    """Name of the processor and number of usable CPUs, to state beside a wall time."""
    cpuinfo = Path("/proc/cpuinfo")
    text = cpuinfo.read_text() if cpuinfo.is_file() else ""
    name = processor(text) or platform.processor() or platform.machine()
    return f"{name}, {usable_cpus()} CPU{'s' * (usable_cpus() > 1)}"


def processor(cpuinfo: str) -> str:
    """Name in the text of /proc/cpuinfo, with AMD's generation; empty without one.

    A virtual machine may be told no more than "AMD EPYC", whatever the generation.
    """
    fields = dict(re.findall(r"^(\w[\w ]*?)\s*: (.+)$", cpuinfo, re.M))
    name, family = fields.get("model name", ""), fields.get("cpu family", "")
    if not name.startswith("AMD") or family not in GENERATIONS:
        return name
    newer = family == "25" and int(fields.get("model", 0)) in ZEN_4
    return f"{name} ({'Zen 4' if newer else GENERATIONS[family]})"
