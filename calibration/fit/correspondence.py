"""Which points of the robot are which of the speaker, and what the robot can do with them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.calibration import CalibrationError
from calibration.coupling_rule import CouplingRule, keep_rules
from calibration.run.inverse import MarkersOf, ShapeFeatures, nearest_poses_deg
from lipsync.arrays import Array
from lipsync.markers import MARKERS_47

#: Upper and lower; the middle one says how open a mouth is.
_GAP_NAMES = (
    ("inner_lip_13", "inner_lip_14"),
    ("inner_lip_82", "inner_lip_87"),
    ("inner_lip_312", "inner_lip_317"),
)
_MIDDLE_GAP = _GAP_NAMES[0]
_CORNERS = ("outer_lip_61", "outer_lip_291")
#: Without these nobody knows how open and how wide a mouth is.
LIPS_NEEDED = frozenset((*_MIDDLE_GAP, *_CORNERS))


@dataclass(frozen=True, slots=True)
class Correspondence:
    """Which markers both know. human: indices into the model's markers, in the robot's order."""

    marker_names: tuple[str, ...]
    human: tuple[int, ...]
    shape_features: ShapeFeatures
    corners: tuple[int, int]


def correspond(marker_names: Sequence[str]) -> Correspondence:
    """Find what the robot's markers are called in the speaker's face: the same.

    Raises CalibrationError for names that no model knows, or without the middle and the corners of
    the lips, which say how open and how wide a mouth is.
    """
    names = tuple(marker_names)
    unknown = [name for name in names if name not in MARKERS_47.names]
    if unknown:
        raise CalibrationError(
            f"marker {unknown[0]!r} is none of a speaker's; known: {', '.join(MARKERS_47.names)}"
        )
    for name in (*_MIDDLE_GAP, *_CORNERS):
        if name not in names:
            raise CalibrationError(f"marker {name!r} is needed and was not captured")
    human = tuple(MARKERS_47.names.index(name) for name in names)
    lips = tuple(i for i, h in enumerate(human) if h in MARKERS_47.lips)
    gaps = tuple(
        (names.index(upper), names.index(lower))
        for upper, lower in _GAP_NAMES
        if upper in names and lower in names
    )
    right, left = (names.index(name) for name in _CORNERS)
    return Correspondence(names, human, ShapeFeatures(lips, gaps), (right, left))


@dataclass(frozen=True, slots=True)
class RobotMouth:
    """A face as far as it is known, what is looked at in it, and what its joints may do.

    stopped_of: the markers where lips stop each other, which markers_of lets overlap.
    """

    markers_of: MarkersOf
    names: Correspondence
    limits_deg: tuple[Array, Array]
    rules: tuple[CouplingRule, ...] = ()
    stopped_of: MarkersOf | None = None

    def seen_mm(self, poses_deg: Array) -> Array:
        """(n, n_servos) -> (n, n_markers, 3), where a tracker would see them."""
        return (self.stopped_of or self.markers_of)(poses_deg)

    def neutral_mm(self) -> Array:
        """(n_markers, 3), all joints at 0."""
        return np.asarray(self.markers_of(np.zeros((1, len(self.limits_deg[0]))))[0])

    def nearest_deg(self, wanted: Array) -> Array:
        """Features (n, n_features) of shapes -> (n, n_servos), the poses that come nearest."""
        shape_features = self.names.shape_features
        return nearest_poses_deg(
            self.markers_of, wanted, shape_features, self.limits_deg, rules=self.rules
        )

    def kept_deg(self, free_deg: Array) -> Array:
        """(n, n_servos) -> the same within limits and rules, as the live path keeps them."""
        within_deg: Array = np.clip(free_deg, *self.limits_deg)
        if not self.rules:
            return within_deg
        return np.array([keep_rules(self.rules, degrees) for degrees in within_deg])
