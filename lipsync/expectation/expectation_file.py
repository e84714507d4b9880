"""The learned expectation in a model file."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from lipsync.expectation.expectation import Expectation, expectation_of
from lipsync.face.model_file import ModelFile

#: The part of a model file that holds the expectation.
EXPECTATION_PART = "expectation"


def read_expectation(file: ModelFile, n_components: int) -> Expectation:
    """The expectation of an open model file. Raises ModelError.

    n_components: of the face that it is to move.
    """

    def assemble(arrays: Mapping[str, NDArray[np.generic]]) -> Expectation:
        found = {name: np.asarray(array, dtype=np.float64) for name, array in arrays.items()}
        expectation = expectation_of(found)
        expectation.check(n_components)
        return expectation

    return file.read(EXPECTATION_PART, assemble)


def expectation_arrays(expectation: Expectation) -> dict[str, NDArray[np.generic]]:
    """What a file keeps of an expectation, float32."""
    return {name: values.astype(np.float32) for name, values in expectation.arrays().items()}
