"""The array that angles, speeds and times come in."""

import numpy as np
from numpy.typing import NDArray

#: float64 of any shape; docstrings say which.
Array = NDArray[np.float64]
