"""Compare the result of a recipe with the shipped result, over training seeds."""

from dataclasses import asdict
from typing import Any

from manip.evaluation.results_table import result_percent
from manip.evaluation.shipped_results import Result, Results
from manip.evaluation.statistics import compare_seeds


def verdict(result: Result, stored: Results) -> str:
    """Compare the rates of all seeds; "new" if there is no shipped result."""
    before = stored.of(result.key)
    return compare_seeds(result.counts, before.counts) if before else "new"


def comparison_line(result: Result, stored: Results) -> str:
    """One line: recipe, its rate, the shipped rate, and the verdict."""
    before = stored.of(result.key)
    shipped = f", shipped {result_percent(before)}" if before else ""
    rate = f"success_held {result_percent(result)} %{shipped}"
    return f"{' '.join(result.key)}: {rate}: {verdict(result, stored)}"


def comparison_record(result: Result, stored: Results) -> dict[str, Any]:
    """Plain values for JSON: the result, its interval, shipped rate and verdict."""
    before = stored.of(result.key)
    runs = [run.to_dict() | {"rate": asdict(run.rate)} for run in result.runs]
    return result.to_dict() | {
        "runs": runs,
        "seeds": len(runs),
        "rate": asdict(result.rate),
        "interval_covers": "seeds and episodes" if len(runs) > 1 else "episodes only",
        "shipped": asdict(before.rate) if before else None,
        "shipped_seeds": len(before.runs) if before else 0,
        "verdict": verdict(result, stored),
    }
