"""Train for long and watch the process: memory, open files, speed; see --help.

Peak memory [MiB], open files and steps per second are measured between the rows of
metrics.csv. The first half of the run is warm-up, in which the replay buffer fills. A
run is steady if its last quarter needs at most 1 % more memory and no more files than
the third quarter, and is at most 10 % slower, in steps per CPU second (other load on
the machine affects wall time more).
"""

import argparse
import contextlib
import csv
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import median
from typing import NamedTuple

INTERVAL = 1.0
"""Seconds between two measurements."""


class Stretch(NamedTuple):
    """Memory, open files and speed of the process between two rows of its metrics."""

    env_steps: int
    memory: float
    files: int
    speed: float
    cpu_speed: float


class Process:
    """A training process, measured through /proc."""

    def __init__(self, command: Sequence[str]) -> None:
        self.child = subprocess.Popen(command, stderr=subprocess.DEVNULL)
        self._proc = Path("/proc") / str(self.child.pid)

    def memory(self) -> float:
        """Resident memory [MiB]."""
        pages = int((self._proc / "statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / 2**20

    def files(self) -> int:
        """Open file handles."""
        return len(os.listdir(self._proc / "fd"))

    def cpu_seconds(self) -> float:
        """CPU time of all its threads so far."""
        fields = (self._proc / "stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main() -> int:
    """Train and measure; 0 if the process was steady."""
    options, train = _options()
    with tempfile.TemporaryDirectory(prefix="soak-") as folder:
        out = Path(folder) / "run"
        command = [sys.executable, "-m", "manip.programs.main", "train"]
        command += ["--task", options.task, "--algo", options.algo]
        command += ["--steps", str(options.steps), "--out", str(out)]
        command += ["--eval-every", str(-(-options.steps // 100)), *train]
        process = Process(command)
        try:
            stretches = list(_stretches(process, out / "metrics.csv"))
        finally:
            process.child.terminate()
            code = process.child.wait()
    if code or len(stretches) < 8:
        print(f"the training ended with exit code {code} after {len(stretches)} rows")
        return 2
    return _report(stretches, options.json)


def _options() -> tuple[argparse.Namespace, list[str]]:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--task", default="Reach", help="task to train (Reach)")
    parser.add_argument("--algo", default="sac", help="algorithm (sac)")
    parser.add_argument("--steps", type=int, default=1_000_000, help="(1000000)")
    parser.add_argument("--json", type=Path, help="file for the figures")
    parser.epilog = "All other options go to `manip train`."
    return parser.parse_known_args()


def _stretches(process: Process, metrics: Path) -> Iterator[Stretch]:
    """Yield a stretch for each new evaluation in the metrics."""
    memory, files, known = 0.0, 0, 0
    steps, seconds, cpu = 0, time.monotonic(), 0.0
    while process.child.poll() is None:
        with contextlib.suppress(OSError):  # the process may be ending
            memory, files = max(memory, process.memory()), max(files, process.files())
        rows = _rows(metrics)
        if len(rows) > known:
            now, used = time.monotonic(), process.cpu_seconds()
            done = int(rows[-1]["env_steps"])
            speeds = (done - steps) / (now - seconds), (done - steps) / (used - cpu)
            stretch = Stretch(done, memory, files, *speeds)
            print(_line(stretch), flush=True)
            yield stretch
            memory, files, known = 0.0, 0, len(rows)
            steps, seconds, cpu = done, now, used
        time.sleep(INTERVAL)


def _rows(metrics: Path) -> list[dict[str, str]]:
    if not metrics.is_file():
        return []
    with metrics.open(newline="") as file:
        return [row for row in csv.DictReader(file) if row.get("eval/return")]


def _line(stretch: Stretch) -> str:
    return (
        f"step {stretch.env_steps:>10,}  {stretch.memory:8.1f} MiB  "
        f"{stretch.files:3} files  {stretch.speed:7.0f} steps/s  "
        f"{stretch.cpu_speed:7.0f} steps/CPU s"
    )


def _report(stretches: Sequence[Stretch], to: Path | None) -> int:
    quarter = len(stretches) // 4
    before, after = stretches[2 * quarter : 3 * quarter], stretches[3 * quarter :]
    memory, files, speed, cpu_speed = (
        [median(getattr(s, name) for s in part) for part in (before, after)]
        for name in ("memory", "files", "speed", "cpu_speed")
    )
    figures = {
        "env_steps": stretches[-1].env_steps,
        "memory_mib": memory[1],
        "memory_growth": memory[1] / memory[0] - 1,
        "files_growth": files[1] - files[0],
        "speed_ratio": speed[1] / speed[0],
        "cpu_speed_ratio": cpu_speed[1] / cpu_speed[0],
    }
    print(json.dumps(figures, indent=2))
    if to:
        rows = [stretch._asdict() for stretch in stretches]
        to.write_text(json.dumps({"figures": figures, "stretches": rows}, indent=2))
    steady = figures["memory_growth"] <= 0.01 and figures["files_growth"] <= 0
    return 0 if steady and figures["cpu_speed_ratio"] >= 0.9 else 1


if __name__ == "__main__":
    sys.exit(main())
