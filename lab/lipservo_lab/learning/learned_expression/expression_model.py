"""A learned model of a person's head, gaze and lids; and its file, one .npz without pickle."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lipservo_lab.learning.learned_expression.pose_mixture import N_AXES, PoseMixture
from lipsync.array_archive import UNREADABLE, arrays_of
from lipsync.arrays import Array
from lipsync.errors import UserError
from lipsync.output_file import written_whole

#: Poses a second inside the model; tracks are brought to it.
RATE_HZ = 25.0
#: Gaze follows the head of so many poses, the newest among them.
HEAD_POSES = 6
#: Lids follow the gaze of so many poses.
GAZE_POSES = 3
N_GAZE_INPUTS = N_AXES * HEAD_POSES + 3
N_LID_INPUTS = GAZE_POSES + 3
_FORMAT = 1
#: A thousand times a usual one, unpacked.
_MOST_BYTES = 16_000_000


class ExpressionModelError(UserError):
    """A file of learned expression cannot be used; one line: which, what, what to do."""


@dataclass(frozen=True, slots=True)
class ExpressionModel:
    """What was learned; None where the tracks had none of it.

    head: of the pose in degrees from its usual one; farthest_deg: (3,), poses stay within.
    gaze: (2, 21), from `gaze_inputs` to the eyes' yaw and pitch in degrees; farthest_gaze_deg (2,).
    lids: (6,), from `lid_inputs` to how far they are shut. blinks: mean and standard deviation of
    the natural logarithm of the intervals in seconds.
    """

    head: PoseMixture
    farthest_deg: Array
    gaze: Array | None = None
    farthest_gaze_deg: Array | None = None
    lids: Array | None = None
    blinks: tuple[float, float] | None = None


def gaze_inputs(poses_deg: Array, prosody: Array) -> Array:
    """Return the inputs of gaze.

    Parameters
    ----------
    poses_deg : Array
        (6, 3), the newest first.
    prosody : Array
        (2,): pitch and loudness z.

    Returns
    -------
    Array
        (21,); the last is 1.
    """
    return np.concatenate((poses_deg.ravel(), prosody, (1.0,)))


def lid_inputs(gaze_pitches_deg: Array, head_pitch_deg: float) -> Array:
    """Return the inputs of the lids; down is positive.

    Parameters
    ----------
    gaze_pitches_deg : Array
        (3,), newest first.
    head_pitch_deg : float
        The head's.

    Returns
    -------
    Array
        (6,).
    """
    nod = (max(0.0, -head_pitch_deg), max(0.0, head_pitch_deg), 1.0)
    return np.concatenate((np.maximum(0.0, -gaze_pitches_deg), nod))


def save_expression(model: ExpressionModel, path: Path) -> None:
    """Write the model whole or not at all, some 15 kB. Raises OutputError."""
    arrays: dict[str, NDArray[np.generic]] = {
        "format": np.array(_FORMAT),
        "weights": model.head.weights,
        "means": model.head.means,
        "precisions": model.head.precisions,
        "farthest_deg": model.farthest_deg,
    }
    if model.gaze is not None and model.farthest_gaze_deg is not None:
        arrays |= {"gaze": model.gaze, "farthest_gaze_deg": model.farthest_gaze_deg}
    if model.lids is not None:
        arrays["lids"] = model.lids
    if model.blinks is not None:
        arrays["blinks"] = np.array(model.blinks)
    with written_whole(path) as partial, partial.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)


def is_expression(head: bytes) -> bool:
    """Whether a file that begins so looks like learned expression: a zip that begins `format`."""
    return head.startswith(b"PK") and b"format.npy" in head


def load_expression(path: Path) -> ExpressionModel:
    """Read a model. Raises ExpressionModelError for one that is missing, damaged or foreign."""
    try:
        with path.open("rb") as file:
            arrays = arrays_of(file, _MOST_BYTES)
    except FileNotFoundError:
        raise ExpressionModelError(
            f"{path}: no such file; make one with `lipservo learn expression`"
        ) from None
    except UNREADABLE as error:
        raise ExpressionModelError(
            f"{path}: damaged or no learned expression; copy or train it again"
        ) from error
    try:
        return _model(arrays)
    except KeyError as error:
        raise ExpressionModelError(f"{path}: no learned expression: {error} is missing") from error
    except (ValueError, TypeError, IndexError) as error:
        raise ExpressionModelError(f"{path}: {error}; copy or train it again") from error


def _model(arrays: dict[str, NDArray[np.generic]]) -> ExpressionModel:
    if int(arrays["format"]) != _FORMAT:
        raise ValueError(f"format {arrays['format']}, this lipservo reads {_FORMAT}")
    mixture = PoseMixture(
        _numbers(arrays["weights"]),
        _numbers(arrays["means"]),
        _numbers(arrays["precisions"]),
        1.0 / RATE_HZ,
    )
    gaze, lids, blinks = arrays.get("gaze"), arrays.get("lids"), arrays.get("blinks")
    return ExpressionModel(
        mixture,
        _numbers(arrays["farthest_deg"], (N_AXES,)),
        None if gaze is None else _numbers(gaze, (2, N_GAZE_INPUTS)),
        None if gaze is None else _numbers(arrays["farthest_gaze_deg"], (2,)),
        None if lids is None else _numbers(lids, (N_LID_INPUTS,)),
        None if blinks is None else tuple(_numbers(blinks, (2,)).tolist()),
    )


def _numbers(array: NDArray[np.generic], shape: tuple[int, ...] | None = None) -> Array:
    numbers = np.asarray(array, dtype=np.float64)
    if shape is not None and numbers.shape != shape:
        raise ValueError(f"an array has the shape {numbers.shape} where {shape} is needed")
    if not np.isfinite(numbers).all():
        raise ValueError("it holds values that are no numbers")
    return numbers
