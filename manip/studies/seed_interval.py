"""Mean over training seeds with Student's interval.

Exact for normal values. With three seeds t is 4.3: a bootstrap of three values, which
cannot leave their range, would be too narrow.
"""

from collections.abc import Sequence
from math import nan
from statistics import fmean

from manip.evaluation.statistics import student_half_width
from manip.studies.bootstrap import Interval


def seed_interval(values: Sequence[float]) -> Interval:
    """Mean of the values of n seeds and its 95 % interval; nan bounds for one seed."""
    mean = fmean(values)
    half = student_half_width(values) if len(values) > 1 else nan
    return Interval(mean, mean - half, mean + half)
