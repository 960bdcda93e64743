"""The diagnosis of runs from their training metrics."""

import pytest

from manip.evaluation.diagnosis import diagnose

MILESTONES = ("near", "grasp", "lift")
HEALTHY = (0, 1, 2, 3, 4, 5, 6, 7, 8, 9)
"""Rates in tenths, at ten equally spaced rows of a run of 10,000 steps."""


def rows(**rates: tuple[int, ...]) -> list[dict[str, float]]:
    """Rows with rates in tenths; each measure of success is that of `lift`."""
    success = {f"success_{kind}": rates["lift"] for kind in ("once", "at_end", "held")}
    columns = success | rates
    return [{"env_steps": 500}] + [
        {"env_steps": 1000 * (i + 1)}
        | {f"train/{name}": tenths[i] / 10 for name, tenths in columns.items()}
        for i in range(len(rates["lift"]))
    ]


FLAT = (0,) * 10


@pytest.mark.parametrize(
    ("rates", "words"),
    [
        ({"near": HEALTHY, "grasp": HEALTHY, "lift": HEALTHY}, ""),
        ({"near": HEALTHY, "grasp": FLAT, "lift": FLAT}, "stuck at grasp for 10 k"),
        ({"near": FLAT, "grasp": FLAT, "lift": FLAT}, "stuck at near for 10 k"),
        ({"near": HEALTHY, "grasp": FLAT, "lift": HEALTHY}, ""),
        (
            {"near": HEALTHY, "grasp": HEALTHY, "lift": (0, 1, 2, 2, 2, 2, 2, 2, 2, 2)},
            "stuck at lift for 7.0 k",
        ),
        (
            {"near": HEALTHY, "grasp": HEALTHY, "lift": (0, 0, 0, 0, 0, 0, 0, 0, 1, 2)},
            "",
        ),
        (
            {"near": HEALTHY, "grasp": HEALTHY, "lift": (0, 2, 5, 9, 9, 9, 8, 6, 3, 2)},
            "lift has fallen to 20%",
        ),
        (
            {"near": HEALTHY, "grasp": HEALTHY, "lift": HEALTHY, "success_held": FLAT},
            "succeeds, but success_held is 0%",
        ),
    ],
)
def test_the_first_thing_that_keeps_a_run_from_success_is_named(rates, words) -> None:
    diagnosis = diagnose(rows(**rates), MILESTONES, 10_000)
    assert (diagnosis.words if diagnosis else "").partition(" steps")[0].partition(":")[
        0
    ] == words
    if diagnosis:
        assert diagnosis.words.endswith("see docs/troubleshooting.md")


def test_a_run_without_finished_episodes_has_no_diagnosis() -> None:
    assert diagnose([{"env_steps": 64, "learn/loss": 1.0}], MILESTONES, 10_000) is None


def test_a_short_run_is_not_stuck_early() -> None:
    flat = rows(near=FLAT, grasp=FLAT, lift=FLAT)
    assert diagnose(flat[:5], MILESTONES, 10_000) is None  # 4,000 steps
    assert diagnose(flat[:6], MILESTONES, 10_000) is not None
    assert diagnose(flat[:6], MILESTONES, 60_000) is None
