"""Kill sweeps with SIGKILL, repeat their command, and compare with a whole sweep.

The process of the sweep is killed after a random time, which its worker processes do
not survive. Every kill is followed by the same command. A run that had finished must
not be touched again. Once a sweep has finished, its results and the metrics,
checkpoints and policies of all its runs must equal those of the uninterrupted sweep,
bit for bit.
"""

import argparse
import csv
import json
import os
import random
import signal
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # read when torch is loaded

from kill_runs import same_runs

from manip.programs import cli, sweep

SWEEP = """
    --task Reach --num-envs 4 --horizon 20 --steps 6400 --eval-every 640
    --eval-episodes 2 --checkpoint-every 0 --agent.actor-hidden 16
    --agent.critic-hidden 16 --agent.rollout-length 16 --algo ppo a2c --seed 0:2
    --episodes 1 --processes 2
"""
"""Four runs, two at a time, each evaluated in stock robosuite."""


def main() -> int:
    """Kill and compare; 0 if every sweep equals the uninterrupted one."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kills", type=int, default=20, help="their number (20)")
    parser.add_argument("--seed", type=int, default=0, help="of the moments (0)")
    parser.add_argument("--longest", type=float, default=30.0, help="to a kill [s]")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="kill-sweep-") as folder:
        counts = Trial(Path(folder), random.Random(options.seed), options.longest).kill(
            options.kills
        )
    print(json.dumps(counts), flush=True)
    good = counts["equal"] == counts["sweeps"] and counts["repeated"] == 0
    return 0 if good else 1


class Trial:
    """Sweeps: an uninterrupted one, and those that are killed."""

    def __init__(self, folder: Path, chance: random.Random, longest: float) -> None:
        self._folder, self._chance, self._longest = folder, chance, longest
        self._whole = folder / "whole"

    def kill(self, kills: int) -> dict[str, int]:
        """Kill so many times, over as many sweeps as that takes; return the counts."""
        self._check(self._attempt(self._whole, None))
        counts = {"kills": 0, "sweeps": 0, "equal": 0, "repeated": 0}
        while counts["kills"] < kills:
            counts["sweeps"] += 1
            out = self._folder / f"sweep{counts['sweeps']}"
            finished: dict[Path, int] = {}
            while True:
                spared = counts["kills"] == kills
                longest = None if spared else self._chance.uniform(0, self._longest)
                code = self._attempt(out, longest)
                now = finish_times(out)
                counts["repeated"] += not finished.items() <= now.items()
                finished = now
                if code == 0:
                    break
                if code != -signal.SIGKILL:
                    self._check(code)
                counts["kills"] += 1
            counts["equal"] += same_sweeps(self._whole, out)
        return counts

    def _check(self, code: int) -> None:
        """Raise with the sweep's messages if it did not end well."""
        if code:
            raise RuntimeError((self._folder / "log").read_text())

    def _attempt(self, out: Path, longest: float | None) -> int:
        """Start or continue a sweep, and kill it after some seconds."""
        child = os.fork()
        if not child:
            log = os.open(self._folder / "log", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            for stream in (1, 2):
                os.dup2(log, stream)
            os._exit(cli.run(sweep.main, [*SWEEP.split(), "--out", str(out)]))
        end = time.monotonic() + (longest if longest is not None else float("inf"))
        while True:
            ended, status = os.waitpid(child, os.WNOHANG)
            if ended:
                return os.waitstatus_to_exitcode(status)
            if time.monotonic() > end:
                os.kill(child, signal.SIGKILL)
                end = float("inf")
            time.sleep(0.02)


def finish_times(out: Path) -> dict[Path, int]:
    """Result of each finished run -> when it was written."""
    return {path: path.stat().st_mtime_ns for path in out.glob("runs/*/result.json")}


def same_sweeps(out: Path, other: Path) -> bool:
    """Whether two sweeps have the same runs and results, times apart."""
    runs = [sorted(path.name for path in (o / "runs").iterdir()) for o in (out, other)]
    return (
        runs[0] == runs[1]
        and all(same_runs(out / "runs" / n, other / "runs" / n) for n in runs[0])
        and _results(out) == _results(other)
    )


def _results(out: Path) -> list[dict[str, str]]:
    with (out / "results.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    return [{k: v for k, v in row.items() if k != "seconds"} for row in rows]


if __name__ == "__main__":
    sys.exit(main())
