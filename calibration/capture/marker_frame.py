"""Whether markers are in millimetres, x to the robot's left, y up, z forward; what else they are.

Compared with the speaker's closed mouth by every exchange and turning round of axes: a robot is
another face, but its nose is above its chin and its left is not its right.
"""

from itertools import permutations, product

import numpy as np

from calibration.calibration import CalibrationError
from lipsync.arrays import Array
from lipsync.face.model import FaceModel
from lipsync.markers import MARKERS_47

#: With fewer markers several ways round look alike.
_LEAST_MARKERS = 8
#: Another way round must be so much more like a face, and a face it must be.
_BETTER, _A_FACE = 0.1, 0.85
#: Faces of robots are from three fifths to one and a half times a person's; others are units.
_SIZES = (0.62, 1.6)
#: Nothing is seen along an axis on which the markers are as flat as this.
_FLAT_MM = 1e-6
_AXES = ("x", "y", "z")
_NAMES: dict[tuple[int, ...], str] = {
    (-1, 1, 1): "are mirrored: x should grow to the robot's own left",
    (1, -1, 1): "are upside down: y should grow upwards",
    (1, 1, -1): "are turned back to front: z should grow forwards",
    (-1, -1, 1): "are turned by half a turn: x should grow to the robot's left and y upwards",
    (-1, 1, -1): "are seen from behind: x should grow to the robot's left and z forwards",
    (1, -1, -1): "are upside down and back to front: y should grow upwards and z forwards",
}


def frame_faults(
    marker_names: tuple[str, ...], usual_mm: Array, model: FaceModel
) -> tuple[str | None, str | None]:
    """usual_mm: (n_markers, 3) -> what is wrong with the axes, and with the size; or None."""
    known = [i for i, name in enumerate(marker_names) if name in MARKERS_47.names]
    known = [i for i in known if np.isfinite(usual_mm[i]).all()]
    if len(known) < _LEAST_MARKERS:
        return None, None
    rest_mm = model.markers_mm(model.rest[None])[0]
    human = rest_mm[[MARKERS_47.names.index(marker_names[i]) for i in known]]
    human, robot = human - human.mean(axis=0), usual_mm[known] - usual_mm[known].mean(axis=0)
    flat = bool(np.ptp(robot[:, 2]) < _FLAT_MM)
    n = 2 if flat else 3
    robot, human = robot[:, :n], human[:, :n]
    upright = _likeness(robot, human)
    best, order, signs = max(
        (_likeness(robot, human[:, order] * signs), order, signs)
        for order in permutations(range(n))
        for signs in product((1, -1), repeat=n)
    )
    size = float(np.linalg.norm(robot) / np.linalg.norm(human))
    axes = None
    if best > upright + _BETTER and best > _A_FACE:
        full = (*signs, 1)[:3]
        if size > _SIZES[1] and order[:2] == (0, 1) and full[:2] == (1, -1):
            axes = (
                "the markers look like pixels of a picture (y grows downwards, the mouth is "
                f"{size:.1f} times a person's): give millimetres, y upwards"
            )
        elif order == tuple(range(n)):
            axes = f"the markers {_NAMES.get(full, 'are turned round on all three axes')}"
        else:
            given = ", ".join(
                f"{_AXES[k]} is {'-' if signs[k] < 0 else ''}{_AXES[order[k]]}" for k in range(n)
            )
            axes = f"the markers' axes are exchanged ({given}): x left, y up, z forward"
    elif flat and size > _SIZES[1]:
        axes = f"the markers look like pixels of a picture ({size:.1f} times a person's face)"
    if axes is not None or _SIZES[0] <= size <= _SIZES[1]:
        return axes, None
    return None, (
        f"the scale is odd: the face is {size:.2f} times as large as a person's; are the markers "
        "in millimetres?"
    )


def check_frame(
    marker_names: tuple[str, ...], usual_mm: Array, model: FaceModel, *, accept: bool
) -> tuple[str, ...]:
    """Warnings; raises CalibrationError for axes that are wrong, and for a size unless accepted."""
    axes, size = frame_faults(marker_names, usual_mm, model)
    if axes is not None:
        raise CalibrationError(f"{axes}; correct the tracker's axes and capture again")
    if size is not None and not accept:
        raise CalibrationError(f"{size} If the robot is that large, add --accept")
    return () if size is None else (size,)


def _likeness(robot: Array, human: Array) -> float:
    """1: the same shape but for its size, and nothing turned."""
    return float((robot * human).sum() / (np.linalg.norm(robot) * np.linalg.norm(human) + 1e-12))
