"""Draw how each policy moves the arm."""

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes

from manip.studies.motion_study import MotionRow
from manip.studies.plotting import plt, save

MARKERS = {"speed": "o", "torque": "s", "jerk": "^"}
"""Measure of `MotionRow`, a share of the arm's limit -> its marker."""


def draw_motion(rows: Sequence[MotionRow], path: Path) -> None:
    """Write a picture: the shares of the limits and the tilt of each policy."""
    size = (9, 1.4 + 0.3 * len(rows))
    figure, (limits, tilt) = plt.subplots(
        1, 2, figsize=size, sharey=True, layout="constrained", width_ratios=(2, 1)
    )
    _draw_limits(limits, rows)
    tilt.barh(range(len(rows)), [row.hand_tilt for row in rows], height=0.5)
    tilt.set_xlabel("largest tilt of the hand [degree]")
    save(figure, (limits, tilt), path)


def _draw_limits(panel: Axes, rows: Sequence[MotionRow]) -> None:
    for name, marker in MARKERS.items():
        shares = [100 * getattr(row, name) for row in rows]
        panel.plot(shares, range(len(rows)), marker, label=name, alpha=0.8)
    panel.axvline(100, color="black", linewidth=1, label="the arm's limit")
    panel.set(xscale="log", xlabel="largest share of the arm's limit [%]")
    panel.set_yticks(range(len(rows)), [row.policy for row in rows])
    panel.invert_yaxis()
