"""Kill training runs with SIGKILL, resume them, and compare with an uninterrupted one.

`moments` kills a run after a random amount of CPU time, one time in ten while it loads.
`writes` kills it just before a random one of its file operations (create, open, rename,
link, remove, ...), on any file of the run.
Every kill is followed by --resume. Once a run has finished, its metrics, checkpoints
and policy must equal those of the uninterrupted run, bit for bit. `labels` is a run
that learns from preferences: its comparisons must be the same, too.
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
from collections.abc import Callable, Sequence
from itertools import count
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")  # read when torch is loaded

from safetensors import safe_open

from manip.programs import cli, export, train

RUN = """
    --task Reach --num-envs 4 --horizon 20 --steps 3200 --threads 2
    --eval-every 640 --eval-episodes 2 --checkpoint-every 0
    --agent.actor-hidden 16 --agent.critic-hidden 16
"""
SAC = "--algo sac --agent.random-steps 128 --agent.buffer-size 1000"
LABELS = """
    --preferences {run}-labels --labels.labeller noisy --labels.total 60
    --labels.first 20 --labels.per-round 10 --labels.start 320 --labels.every 480
    --labels.clip-steps 5 --labels.recent 400
"""
ALGORITHMS = {
    "ppo": "--algo ppo --agent.rollout-length 16 --agent.minibatches 2",
    "sac": SAC,
    "labels": f"{SAC} {LABELS}",
}
"""A run of seconds that does everything that long ones do."""

TIMES = {"seconds", "cpu_seconds", "steps_per_second"}
"""Columns that depend on the clock."""

FILE_EVENTS = {"open", "os.rename", "os.link", "os.remove", "os.chmod", "os.truncate"}
"""Python's audit events of file operations, raised before the operation."""

Prepare = Callable[[], object]


def main() -> int:
    """Kill and compare; 0 if every run equals the uninterrupted one."""
    options = _options()
    figures = {}
    for algo in options.algos:
        with tempfile.TemporaryDirectory(prefix=f"kill-{algo}-") as folder:
            trial = Trial(algo, Path(folder), random.Random(options.seed))
            figures[algo] = trial.kill(options.when, options.kills)
            print(json.dumps({algo: figures[algo]}), flush=True)
    if options.json:
        options.json.write_text(json.dumps(figures, indent=2) + "\n")
    good = all(f["resumed"] == f["kills"] for f in figures.values())
    return 0 if good and all(f["equal"] == f["runs"] for f in figures.values()) else 1


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("when", nargs="?", choices=["moments", "writes"])
    parser.add_argument("--kills", type=int, default=25, help="an algorithm (25)")
    parser.add_argument("--algos", nargs="+", choices=ALGORITHMS, default=[*ALGORITHMS])
    parser.add_argument("--seed", type=int, default=0, help="of the kills (0)")
    parser.add_argument("--json", type=Path, help="file for the counts")
    parser.set_defaults(when="moments")
    return parser.parse_args()


class Trial:
    """Runs of an algorithm: an uninterrupted one, and those that are killed."""

    def __init__(self, algo: str, folder: Path, chance: random.Random) -> None:
        self._options = f"{RUN} {ALGORITHMS[algo]} --out {{run}}"
        self._folder, self._chance = folder, chance
        self._whole = folder / "whole"

    def kill(self, when: str, kills: int) -> dict[str, int]:
        """Kill so many times, over as many runs as that takes; return the counts."""
        length, least = self._uninterrupted(when), 20 if when == "writes" else 0.0
        counts = {"kills": 0, "resumed": 0, "runs": 0, "equal": 0}
        while counts["kills"] < kills:
            counts["runs"] += 1
            run = self._folder / f"run{counts['runs']}"
            while True:
                distance = self._chance.uniform(0, 2.5 * length / kills + least)
                spared = counts["kills"] == kills
                code = self._attempt(run, when, None if spared else distance)
                if code == 0:
                    break
                if code != -signal.SIGKILL:
                    print((self._folder / "log").read_text(), file=sys.stderr)
                    return counts
                counts["kills"] += 1
                counts["resumed"] += readable(run)
            counts["equal"] += same_runs(self._whole, run)
        return counts

    def _uninterrupted(self, when: str) -> float:
        """Train once; return the CPU seconds or the file operations that it took."""
        if when == "moments":
            child = self._start(self._whole, lambda: None)
            begun = _wait_for_lock(self._whole, child)
            _, status, used = os.wait4(child, 0)
            self._check(status)
            return used.ru_utime + used.ru_stime - begun
        steps = self._folder / "steps"
        child = self._start(self._whole, lambda: count_operations(self._whole, steps))
        self._check(os.waitpid(child, 0)[1])
        return len(steps.read_bytes())

    def _check(self, status: int) -> None:
        """Raise with the run's log if it did not end well."""
        if status:
            raise RuntimeError((self._folder / "log").read_text())

    def _attempt(self, run: Path, when: str, distance: float | None) -> int:
        """Start or resume a run, and kill it after some CPU time or file operations."""
        if distance is None or when == "moments":
            child = self._start(run, lambda: None)
            if distance is not None:
                _kill_after(run, child, distance, self._chance.random() < 0.1)
        else:
            child = self._start(run, lambda: die_at_operation(run, 1 + int(distance)))
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])

    def _start(self, run: Path, prepare: Prepare) -> int:
        saved = any((run / "checkpoints").glob("[!.]*"))
        command = self._options.format(run=run).split() + ["--resume"] * saved
        child = os.fork()
        if child:
            return child
        log = os.open(self._folder / "log", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(log, 2)
        prepare()
        os._exit(cli.run(train.main, command))


def count_operations(run: Path, to: Path) -> None:
    """Write a byte to a file for each operation of this process on the run's files."""
    handle = os.open(to, os.O_WRONLY | os.O_CREAT)
    _before_operations(run, lambda: os.write(handle, b"."))


def die_at_operation(run: Path, number: int) -> None:
    """Kill this process just before one of its operations on the run's files."""
    steps = count(1)

    def step() -> None:
        if next(steps) == number:
            os.kill(os.getpid(), signal.SIGKILL)

    _before_operations(run, step)


def _before_operations(run: Path, act: Callable[[], object]) -> None:
    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        if event in FILE_EVENTS and str(arguments[0]).startswith(str(run)):
            act()

    sys.addaudithook(hook)


def _kill_after(run: Path, child: int, seconds: float, early: bool) -> None:
    """Kill a run after so many CPU seconds of training, or of loading if early."""
    begun = 0.0 if early else _wait_for_lock(run, child)
    while not _ended(child) and cpu_seconds(child) < begun + seconds:
        time.sleep(0.01)
    os.kill(child, signal.SIGKILL)


def _wait_for_lock(run: Path, child: int) -> float:
    """Wait until a run trains; return the CPU seconds that it needed till then."""
    lock = run / "run.lock"
    while not _ended(child):
        if lock.is_file() and f"process {child} " in lock.read_text():
            break
        time.sleep(0.01)
    return cpu_seconds(child)


def _ended(child: int) -> bool:
    return _stat(child)[0] == "Z"


def cpu_seconds(child: int) -> float:
    """CPU time of a process so far."""
    fields = _stat(child)
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _stat(child: int) -> list[str]:
    return Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()


def readable(run: Path) -> bool:
    """Load the policy, if there is one; --resume loads the rest."""
    if (run / "policy" / "policy.safetensors").is_file():
        export.load_run(run)
    return True


def same_runs(run: Path, other: Path) -> bool:
    """Whether two runs have the same metrics, checkpoints and policy."""
    names = ("checkpoints/latest", "checkpoints/best", "policy/policy")
    files = [f"{name}.safetensors" for name in names]
    same = all(_tree(run / name) == _tree(other / name) for name in files)
    return same and _metrics(run) == _metrics(other) and _same_answers(run, other)


def _same_answers(run: Path, other: Path) -> bool:
    """Whether two runs have the same comparisons, if they learn from any."""
    return _answers(run) == _answers(other)


def _answers(run: Path) -> list[tuple[Any, ...]]:
    path = run.with_name(f"{run.name}-labels") / "comparisons.jsonl"
    lines = path.read_text().splitlines() if path.exists() else []
    names = ("round", "left", "right", "answer")
    return [tuple(json.loads(line)[name] for name in names) for line in lines]


def _tree(path: Path) -> tuple[Any, dict[str, bytes]]:
    with safe_open(path, "pt") as file:
        header = json.loads((file.metadata() or {}).get("tree", "{}"))
        tensors = {k: file.get_tensor(k).numpy().tobytes() for k in file.keys()}
    return _timeless(header), tensors


def _timeless(node: Any) -> Any:
    if isinstance(node, dict):
        return {k: _timeless(v) for k, v in node.items() if k not in TIMES}
    return [_timeless(child) for child in node] if isinstance(node, list) else node


def _metrics(run: Path) -> Sequence[dict[str, str]]:
    with (run / "metrics.csv").open(newline="") as file:
        rows: Sequence[dict[str, str]] = _timeless(list(csv.DictReader(file)))
    return rows


if __name__ == "__main__":
    sys.exit(main())
