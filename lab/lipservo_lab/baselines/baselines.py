"""What the baselines have learned from the training sentences; only evaluation reads it."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lipservo_lab.baselines.dominance import Dominance
from lipservo_lab.baselines.regression import PlainRegression
from lipsync.arrays import Array
from lipsync.face.model_file import ModelFile
from lipsync.phonemes import PHONEMES

#: The part of a model file that holds the baselines.
BASELINES_PART = "baselines"


@dataclass(frozen=True, slots=True)
class Baselines:
    """Parameters of all baselines.

    centres: (40, n_components), the mean middle of each of `PHONEMES`; counts: (40,), of how many.
    dominance: tuned; regression: fitted.
    """

    centres: Array
    counts: Array
    dominance: Dominance
    regression: PlainRegression


def read_baselines(file: ModelFile, n_components: int) -> Baselines:
    """The baselines of an open model file, for a face with so many components.

    Raises ModelError.
    """

    def assemble(arrays: Mapping[str, NDArray[np.generic]]) -> Baselines:
        found = {name: np.asarray(array, dtype=np.float64) for name, array in arrays.items()}
        centres = found["centres"]
        if centres.shape != (len(PHONEMES), n_components):
            expected = (len(PHONEMES), n_components)
            raise ValueError(f"centres has shape {centres.shape}, expected {expected}")
        if not np.isfinite(centres).all():
            raise ValueError("centres holds values that are not finite")
        return Baselines(
            centres,
            found["counts"],
            Dominance(*found["dominance"]),
            PlainRegression(found["regression"]),
        )

    return file.read(BASELINES_PART, assemble)


def baseline_arrays(baselines: Baselines) -> dict[str, NDArray[np.generic]]:
    """What a file keeps of the baselines."""
    return {
        "centres": baselines.centres.astype(np.float32),
        "counts": baselines.counts.astype(np.float32),
        "dominance": np.stack([baselines.dominance.rates_per_s, baselines.dominance.powers]),
        "regression": baselines.regression.weights.astype(np.float32),
    }
