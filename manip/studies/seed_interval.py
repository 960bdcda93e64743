"""Mean over training seeds with Student's interval.

    mean +- t_{0.975, n - 1} s / sqrt(n),   s^2 = sum (x - mean)^2 / (n - 1)

Exact for normal values. With three seeds t is 4.3: a bootstrap of three values, which
cannot leave their range, would be too narrow.
"""

from collections.abc import Sequence
from math import nan, sqrt

import numpy as np
from scipy.stats import t as student

from manip.studies.bootstrap import LEVEL, Interval


def seed_interval(values: Sequence[float]) -> Interval:
    """Mean of the values of n seeds and its 95 % interval; nan bounds for one seed."""
    sample = np.asarray(values, float)
    mean, count = float(sample.mean()), len(sample)
    if count < 2:
        return Interval(mean, nan, nan)
    quantile = float(student.ppf((1 + LEVEL) / 2, count - 1))
    half = quantile * float(sample.std(ddof=1)) / sqrt(count)
    return Interval(mean, mean - half, mean + half)
