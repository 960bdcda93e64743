"""Compare what two checkouts of manip learn: the same short runs, bit for bit.

    python scripts/compare_checkouts.py --before ../manip-before --after .

Each checkout trains every algorithm briefly, each run in a separate process and
folder. The script compares the metrics (all but times) and the weights of the best
policy, prints a table, and exits with 1 if a run differs. A checkout uses the Python of
its own .venv where it has one.
"""

import csv
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table
from safetensors import safe_open

from manip.programs import cli

RUNS = {
    ("sac", "Reach"): 3072,
    ("td3", "Reach"): 3072,
    ("dqn", "Reach"): 3072,
    ("bc", "Reach"): 2048,
    ("ppo", "Reach"): 8192,
    ("ppo-kl", "Reach"): 8192,
    ("trpo", "Reach"): 8192,
    ("a2c", "Reach"): 4096,
    ("a3c", "Reach"): 4096,
    ("reinforce", "Reach"): 4096,
    ("sac", "Lift"): 6144,
    ("ppo", "Lift"): 8192,
}
"""(algorithm, task) -> control steps."""

OFF_POLICY = ("sac", "td3", "dqn")
TIMES = ("seconds", "steps_per_second")

Metrics = Mapping[str, list[str]]
"""Column -> its values, evaluation by evaluation (those that choose the policy)."""


@dataclass(frozen=True)
class Compare:
    """Compare what two checkouts of manip learn."""

    before: Path
    """First checkout."""
    after: Path
    """Second checkout."""
    out: Path = Path("runs/compare")
    """Folder of the runs; finished runs are not repeated."""


def main(options: Compare) -> int:
    """Train in both checkouts and print what agrees."""
    table = Table("algorithm", "task", "steps", "metrics", "weights")
    equal = True
    for (algo, task), steps in RUNS.items():
        folders = [
            _trained(checkout.resolve(), options.out.resolve() / side, algo, task)
            for side, checkout in (("before", options.before), ("after", options.after))
        ]
        differing = list(_differing(*map(_metrics, folders)))
        same_weights = _weights(folders[0]) == _weights(folders[1])
        equal &= same_weights and not differing
        verdict = ", ".join(differing) or "equal"
        table.add_row(algo, task, f"{steps:,}", verdict, _word(same_weights))
    Console().print(table)
    return 0 if equal else 1


def _word(same: bool) -> str:
    return "equal" if same else "differ"


def _trained(checkout: Path, out: Path, algo: str, task: str) -> Path:
    """The folder of a finished run, which is trained unless it is there."""
    folder, steps = out / f"{algo}-{task}", RUNS[algo, task]
    if not (folder / "policy").is_dir():
        options = {"task": task, "algo": algo, "steps": steps, "out": folder}
        options |= {"eval-every": steps // 2, "eval-episodes": 16, "threads": 2}
        if algo in OFF_POLICY:
            options["agent.random-steps"] = 512
        _run(checkout, [f"--{name}={value}" for name, value in options.items()])
    return folder


def _run(checkout: Path, arguments: list[str]) -> None:
    python = checkout / ".venv/bin/python"
    command = [python if python.exists() else sys.executable, "scripts/train.py"]
    environment = os.environ | {"PYTHONPATH": str(checkout)}
    subprocess.run([*command, *arguments], check=True, cwd=checkout, env=environment)


def _metrics(folder: Path) -> Metrics:
    with (folder / "metrics.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["eval/return"]]
    names = [name for name in rows[0] if not name.endswith(TIMES)]
    return {name: [row[name] for row in rows] for name in names}


def _differing(before: Metrics, after: Metrics) -> Iterator[str]:
    """Columns of both whose values differ; columns of one alone do not count."""
    for name in before.keys() & after.keys():
        if before[name] != after[name]:
            yield name


def _weights(folder: Path) -> dict[str, bytes]:
    with safe_open(folder / "policy/policy.safetensors", "np") as file:
        return {name: file.get_tensor(name).tobytes() for name in file.keys()}


if __name__ == "__main__":
    sys.exit(main(cli.parse(Compare, sys.argv[1:], "compare_checkouts.py")))
