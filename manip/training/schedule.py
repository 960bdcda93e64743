"""When a run logs a row and evaluates its policy: functions of its steps alone."""

ROWS = 1_000
"""Rows of metrics.csv that a run has at most, besides those of its evaluations."""

LEAST_ROWS = 100
"""Rows that a run of few rollouts has at least: those within a rollout have the results
of its episodes only."""

EXTENSIONS = 3
"""Times that a run below its goal is prolonged, each by a third of its steps."""

PARTS = 10
"""Equal parts of a run, each of which has an evaluation at least."""


def rows_in(rollout: int, steps: int) -> int:
    """Rows of a rollout of so many control steps, the one at its end included."""
    return -(-LEAST_ROWS * rollout // steps)


def row_due(before: int, now: int, steps: int) -> bool:
    """Whether the rollout that ended at step `now` has a row of metrics.csv.

    All have one, but in long runs only the first in each thousandth of the run.

    Args:
        before: control steps of the run before the rollout.
        now: control steps after it.
        steps: of the whole run.
    """
    every = -(-steps // ROWS)
    return now // every > before // every


def extended(steps: int, extra: int) -> int:
    """Control steps to add to a planned number, now that the run is below its goal.

    Args:
        steps: planned.
        extra: added so far.
    """
    return min(extra + -(-steps // EXTENSIONS), steps)


def next_choice(now: int, every: int, steps: int) -> int:
    """Control step of the next evaluation that may choose the best policy."""
    return min((now // every + 1) * every, steps)


def has_curve(every: int, steps: int) -> bool:
    """Whether a run with evaluations every so many steps has light ones, too."""
    return every > -(-steps // PARTS)


def curve_due(before: int, now: int, every: int, steps: int) -> bool:
    """Whether a light evaluation follows the rollout that ended at step `now`.

    One follows each tenth of the run in which no evaluation chooses the policy.

    Args:
        before: control steps of the run before the rollout.
        now: control steps after it.
        every: control steps between evaluations that choose the policy.
        steps: of the whole run.
    """
    part = -(-steps // PARTS)
    end = (before // part + 1) * part
    chosen = end // every > (end - part) // every or end >= steps
    return now >= end and not chosen
