"""Names of array types for the type checker."""

import numpy as np
from numpy.typing import NDArray

#: Shapes and units stand where each is used. `Array32`: what a recogniser computes with.
Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
Indices = NDArray[np.int64]
