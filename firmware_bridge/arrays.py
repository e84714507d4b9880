"""The array that angles, speeds and times come in, and questions about a few flags."""

import numpy as np
from numpy.typing import NDArray

#: float64 of any shape; docstrings say which.
Array = NDArray[np.float64]


def any_set(flags: NDArray[np.bool_] | NDArray[np.integer]) -> bool:
    """Whether any is not 0; for as many as a face has joints, ten times as quick as `any()`."""
    return bool(flags.tobytes().strip(b"\0"))


def all_set(flags: NDArray[np.bool_]) -> bool:
    """Whether all are true, as quickly."""
    return 0 not in flags.tobytes()
