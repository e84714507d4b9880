"""What so few robots leave open: intervals of 95 % beside medians and shares.

A median's: the order statistics that hold it in 95 % of samples, by the binomial distribution
(David and Nagaraja, Order Statistics, 2003, section 7.1), without any assumption. A share's:
Wilson's (Probable inference, 1927), which holds for few and for shares near 0 and 1.
"""

import math
from collections.abc import Sequence

import numpy as np
from scipy.stats import binom

_Z = 1.959964
_TAIL = 0.025


def median_interval(values: Sequence[float]) -> list[float]:
    """[least, most]; of fewer than six values their range, which holds it less often."""
    ordered = np.sort(np.asarray(values, dtype=np.float64))
    if not len(ordered):
        return [math.nan, math.nan]
    below = max(int(binom.ppf(_TAIL, len(ordered), 0.5)) - 1, 0)
    return [float(ordered[below]), float(ordered[-1 - below])]


def share_interval(n_of: int, n: int) -> list[float]:
    """[least, most] of the share that n_of of n are a sample of."""
    if not n:
        return [0.0, 1.0]
    share, turned = n_of / n, _Z**2 / n
    middle = share + turned / 2
    half = _Z * math.sqrt(share * (1.0 - share) / n + turned / (4 * n))
    return [(middle - half) / (1.0 + turned), (middle + half) / (1.0 + turned)]
