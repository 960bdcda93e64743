"""Kill training runs with SIGKILL, resume them, and compare with one left alone.

At `moments`, a run is killed after a random amount of computing, one time in ten while
it loads; in `writes`, just before a random one of its steps on files (create, open,
rename, link, remove, ...), whichever file it is.
Every kill is followed by --resume. When a run has come to its end, its metrics,
checkpoints and policy must equal, bit for bit, those of the run left alone.
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

from manip.programs import cli, evaluate, train

RUN = """
    --task Reach --num-envs 4 --horizon 20 --steps 3200 --threads 2
    --eval-every 640 --eval-episodes 2 --checkpoint-every 0
    --agent.actor-hidden 16 --agent.critic-hidden 16
"""
ALGORITHMS = {
    "ppo": "--agent.rollout-length 16 --agent.minibatches 2",
    "sac": "--agent.random-steps 128 --agent.buffer-size 1000",
}
"""A run that goes in seconds through all that long ones go through."""

TIMES = {"seconds", "cpu_seconds", "steps_per_second"}
"""What a run notes of the clock, and may differ."""

FILE_STEPS = {"open", "os.rename", "os.link", "os.remove", "os.chmod", "os.truncate"}
"""Python's audit events, raised before the step is taken."""

Prepare = Callable[[], object]


def main() -> int:
    """Kill and compare; 0 if every run came to the same end."""
    options = _options()
    figures = {}
    for algo in options.algos:
        with tempfile.TemporaryDirectory(prefix=f"kill-{algo}-") as folder:
            trial = Trial(algo, Path(folder), random.Random(options.seed))
            figures[algo] = trial.hold(options.when, options.kills)
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
    parser.add_argument("--json", type=Path, help="write the figures here, too")
    parser.set_defaults(when="moments")
    return parser.parse_args()


class Trial:
    """Runs of an algorithm: the one left alone, and those that are killed."""

    def __init__(self, algo: str, folder: Path, chance: random.Random) -> None:
        self._command = ["--algo", algo, *f"{RUN} {ALGORITHMS[algo]}".split()]
        self._folder, self._chance = folder, chance
        self._whole = folder / "whole"

    def hold(self, when: str, kills: int) -> dict[str, int]:
        """Kill so many times, over as many runs as that takes."""
        length, least = self._leave_alone(when), 20 if when == "writes" else 0.0
        found = {"kills": 0, "resumed": 0, "runs": 0, "equal": 0}
        while found["kills"] < kills:
            found["runs"] += 1
            run = self._folder / f"run{found['runs']}"
            while True:
                ahead = self._chance.uniform(0, 2.5 * length / kills + least)
                spared = found["kills"] == kills
                code = self._attempt(run, when, None if spared else ahead)
                if code == 0:
                    break
                if code != -signal.SIGKILL:
                    print((self._folder / "log").read_text(), file=sys.stderr)
                    return found
                found["kills"] += 1
                found["resumed"] += readable(run)
            found["equal"] += same_runs(self._whole, run)
        return found

    def _leave_alone(self, when: str) -> float:
        """Train once; how long it took: in CPU seconds or in steps on files."""
        if when == "moments":
            child = self._start(self._whole, lambda: None)
            begun = _wait_for_lock(self._whole, child)
            _, status, used = os.wait4(child, 0)
            self._check(status)
            return used.ru_utime + used.ru_stime - begun
        steps = self._folder / "steps"
        child = self._start(self._whole, lambda: count_steps(self._whole, steps))
        self._check(os.waitpid(child, 0)[1])
        return len(steps.read_bytes())

    def _check(self, status: int) -> None:
        """Raise with the run's log if it did not end well."""
        if status:
            raise RuntimeError((self._folder / "log").read_text())

    def _attempt(self, run: Path, when: str, ahead: float | None) -> int:
        """Begin or resume a run, and kill it when it has gone that far."""
        if ahead is None or when == "moments":
            child = self._start(run, lambda: None)
            if ahead is not None:
                _kill_after(run, child, ahead, self._chance.random() < 0.1)
        else:
            child = self._start(run, lambda: die_at_step(run, 1 + int(ahead)))
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])

    def _start(self, run: Path, prepare: Prepare) -> int:
        saved = any((run / "checkpoints").glob("[!.]*"))
        command = [*self._command, "--out", str(run), *(["--resume"] * saved)]
        child = os.fork()
        if child:
            return child
        log = os.open(self._folder / "log", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(log, 2)
        prepare()
        os._exit(cli.run(train.main, command))


def count_steps(run: Path, to: Path) -> None:
    """Leave a byte in a file for each of this process's steps on files of the run."""
    handle = os.open(to, os.O_WRONLY | os.O_CREAT)
    _before_steps(run, lambda: os.write(handle, b"."))


def die_at_step(run: Path, number: int) -> None:
    """Have this process killed just before one of its steps on files of the run."""
    steps = count(1)

    def step() -> None:
        if next(steps) == number:
            os.kill(os.getpid(), signal.SIGKILL)

    _before_steps(run, step)


def _before_steps(run: Path, act: Callable[[], object]) -> None:
    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        if event in FILE_STEPS and str(arguments[0]).startswith(str(run)):
            act()

    sys.addaudithook(hook)


def _kill_after(run: Path, child: int, ahead: float, early: bool) -> None:
    """Kill a run when it has computed for so many seconds, or so early."""
    begun = 0.0 if early else _wait_for_lock(run, child)
    while not _ended(child) and cpu_seconds(child) < begun + ahead:
        time.sleep(0.01)
    os.kill(child, signal.SIGKILL)


def _wait_for_lock(run: Path, child: int) -> float:
    """CPU seconds that a run needed until it began to train."""
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
    """Whether a policy, if there is one, can be loaded; --resume tries the rest."""
    if (run / "policy" / "policy.safetensors").is_file():
        evaluate.load_policy(run)
    return True


def same_runs(run: Path, other: Path) -> bool:
    """Whether two runs left the same metrics, checkpoints and policy."""
    names = ("checkpoints/latest", "checkpoints/best", "policy/policy")
    files = [f"{name}.safetensors" for name in names]
    same = all(_tree(run / name) == _tree(other / name) for name in files)
    return same and _metrics(run) == _metrics(other)


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
