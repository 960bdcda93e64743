"""The shipped results as rows of text, and as a Markdown table."""

from collections.abc import Iterable, Sequence
from statistics import median

from manip.evaluation.shipped_results import Result, Results, Run
from manip.evaluation.statistics import Rate

HEADER = (
    *("task", "arm", "algo", "demos", "seeds", "success_held [%]", "each seed"),
    *("env steps", "minutes", "machine", "robosuite-benchmark"),
)

ONE_SEED = "*"
"""Behind an interval that covers episodes only."""

NOTE = (
    "success_held: mean over training seeds and its 95 % interval over seeds and "
    f"episodes; {ONE_SEED} one seed: over episodes only"
)


def rows(stored: Results, results: Iterable[Result]) -> list[tuple[str, ...]]:
    """A row of text for each result, under `HEADER`; medians of steps and minutes."""
    return [
        (
            *(result.task, result.robot, result.algo.upper()),
            "yes" if result.demonstrations else "no",
            str(len(result.runs)),
            result_percent(result),
            ", ".join(f"{100 * run.rate.rate:.0f}" for run in result.runs),
            f"{median(run.env_steps for run in result.runs):,.0f}",
            _median_minutes(result.runs),
            result.machine,
            stored.robosuite_benchmark.get(result.task, {}).get(result.robot, ""),
        )
        for result in results
    ]


def percent(rate: Rate) -> str:
    """A rate and its interval: 97 (92-99)."""
    return f"{100 * rate.rate:.0f} ({100 * rate.low:.0f}-{100 * rate.high:.0f})"


def result_percent(result: Result) -> str:
    """The rate of a recipe and its interval, marked where it covers episodes only."""
    return percent(result.rate) + (ONE_SEED if len(result.runs) == 1 else "")


def markdown(stored: Results) -> str:
    """The table of all results in Markdown, with a note on the intervals."""
    lines: list[Sequence[str]] = [HEADER, ("---",) * len(HEADER)]
    lines += rows(stored, stored.results)
    table = "".join("| " + " | ".join(line) + " |\n" for line in lines)
    return f"{table}\n{NOTE}.\n".replace(ONE_SEED, f"\\{ONE_SEED}")


def _median_minutes(runs: Iterable[Run]) -> str:
    measured = [run.minutes for run in runs if run.minutes is not None]
    return f"{median(measured):.1f}" if measured else ""
