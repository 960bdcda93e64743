"""Finished or running runs from their folders, in groups of equal options."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from manip.errors import UserError, one_line
from manip.evaluation.statistics import Rate, SeedCount, rate_over_seeds
from manip.training.config import TrainConfig, lasting, recorded
from manip.training.run_folder import run_folders
from manip.training.run_logs import read_numbers

MEASURE = "success_held"

FIRST = ("task", "algo", "robot", "steps")
"""Options that name a group, before all others that differ."""

NONE = "-"
"""Value of an option that a run does not have."""


@dataclass(frozen=True)
class Run:
    """A run as its folder shows it.

    Attributes:
        folder: the run folder.
        seed: its seed.
        options: option -> value as text; all that make the run what it is, but the
            seed.
        rows: of its metrics.csv.
        final: success_held of its best policy; None before the first evaluation.
        source: the evaluation that `final` is from: "stock" or "native" (eval.json), or
            "training".
    """

    folder: Path
    seed: int
    options: Mapping[str, str]
    rows: Sequence[Mapping[str, float]]
    final: SeedCount | None
    source: str

    @property
    def steps(self) -> int:
        """Control steps so far."""
        return int(self.rows[-1]["env_steps"]) if self.rows else 0

    @property
    def seconds(self) -> float:
        """Wall time of training so far [s]."""
        return self.rows[-1]["seconds"] if self.rows else 0.0


@dataclass(frozen=True)
class Group:
    """Runs that differ in their seeds only.

    Attributes:
        name: of the options in which it differs from the other groups.
        runs: by seed.
    """

    name: str
    runs: Sequence[Run]

    @property
    def options(self) -> Mapping[str, str]:
        """The options of its runs."""
        return self.runs[0].options

    @property
    def counts(self) -> list[SeedCount]:
        """Successes of the runs that have been evaluated."""
        return [run.final for run in self.runs if run.final]

    @property
    def rate(self) -> Rate | None:
        """success_held and its interval; None before the first evaluation."""
        return rate_over_seeds(self.counts) if self.counts else None


def load_runs(folders: Sequence[Path]) -> list[Run]:
    """The runs in folders; a folder that holds run folders stands for these.

    Raises:
        UserError: a folder holds no run, or a damaged one; one is given twice.
    """
    paths = [path for folder in folders for path in _named(folder)]
    places = [path.resolve() for path in paths]
    for path, place in zip(paths, places, strict=True):
        if places.count(place) > 1:
            raise UserError(f"{path} is given twice: name each run once")
    return [_load(path) for path in paths]


def _named(folder: Path) -> list[Path]:
    paths = run_folders(folder)
    if not paths:
        raise UserError(
            f"{folder} holds no run: name a run folder (with config.yaml), or a folder "
            "of run folders"
        )
    return paths


def _load(folder: Path) -> Run:
    config = recorded(folder)
    rows = read_numbers(folder / "metrics.csv")
    final, source = _evaluated(folder / "eval.json") or _chosen(rows, config)
    options = lasting(config) | {"steps": config.steps}
    return Run(
        folder=folder,
        seed=options.pop("seed"),
        options={name: _text(value) for name, value in options.items()},
        rows=rows,
        final=final,
        source=source,
    )


def _text(value: Any) -> str:
    return " ".join(map(str, value)) if isinstance(value, list) else str(value)


def _evaluated(path: Path) -> tuple[SeedCount, str] | None:
    """Successes in the evaluation at the end of a run, if there was one."""
    if not path.is_file():
        return None
    try:
        result = json.loads(path.read_text(encoding="utf-8"))
        rate, episodes = result["success"][MEASURE]["rate"], int(result["episodes"])
        return SeedCount(round(rate * episodes), episodes), str(result["env"])
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise UserError(f"{path} is damaged: {one_line(error)}; remove it") from error


def _chosen(
    rows: Sequence[Mapping[str, float]], config: TrainConfig
) -> tuple[SeedCount | None, str]:
    """Successes in the evaluation that chose the best policy."""
    chosen = [row for row in rows if f"eval/{MEASURE}" in row]
    if not chosen:
        return None, "training"
    best = max(chosen, key=lambda row: (row[f"eval/{MEASURE}"], row["eval/return"]))
    episodes = config.eval_episodes
    return SeedCount(round(best[f"eval/{MEASURE}"] * episodes), episodes), "training"


def groups_of(runs: Sequence[Run]) -> list[Group]:
    """Groups of runs with equal options, in the order of the runs.

    Runs that have equal options and seeds are in different groups: of different
    versions, for example.
    """
    groups: dict[tuple[Any, int], list[Run]] = {}
    for run in runs:
        options, twin = tuple(sorted(run.options.items())), 0
        while any(r.seed == run.seed for r in groups.get((options, twin), ())):
            twin += 1
        groups.setdefault((options, twin), []).append(run)
    members = [sorted(group, key=lambda run: run.seed) for group in groups.values()]
    names = _names([group[0] for group in members])
    return [Group(*pair) for pair in zip(names, members, strict=True)]


def differences(options: Sequence[Mapping[str, str]]) -> list[str]:
    """Names of the options whose values differ, those of `FIRST` first."""
    names = dict.fromkeys((*FIRST, *(name for values in options for name in values)))
    return [n for n in names if len({values.get(n, NONE) for values in options}) > 1]


def _names(runs: Sequence[Run]) -> list[str]:
    """Task and algorithm, and as few other options as tell all groups apart."""
    parts = [[r.options["task"], r.options["algo"]] for r in runs]
    for option in _telling(runs):
        if len({*map(tuple, parts)}) == len(runs):
            break
        for part, run in zip(parts, runs, strict=True):
            part.append(f"{option.split('.')[-1]}={run.options.get(option, NONE)}")
    names = [" ".join(part) for part in parts]
    return [
        name if names.count(name) == 1 else f"{name} ({run.folder})"
        for name, run in zip(names, runs, strict=True)
    ]


def _telling(runs: Sequence[Run]) -> Iterator[str]:
    """Options that differ between runs of one task and algorithm."""
    kinds: dict[tuple[str, str], list[Mapping[str, str]]] = {}
    for run in runs:
        kind = run.options["task"], run.options["algo"]
        kinds.setdefault(kind, []).append(run.options)
    yield from dict.fromkeys(n for kind in kinds.values() for n in differences(kind))
