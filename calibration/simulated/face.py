"""The geometry of the simulated face: its 47 markers as a function of servo angles.

A rubber skin in the shape of the model's closed mouth, over a hinged jaw, pulled by servo horns.
First the horns displace the skin, then the jaw carries along what hangs on it:

    p = n + sum_s arm * sin(angle_s) * pull_s,    p' = p + w * (R(jaw) (p - axis) + axis - p)

n: neutral marker; pull_s: direction times a weight in 0..1 that fades with the distance from the
horn's attachment; w: the share of the jaw's turn that the marker follows, 0..1. Axes as everywhere:
x to the robot's own LEFT (right in its picture), y up, z forward, millimetres.
Not simulated: gravity, elastic coupling, lips that stop each other (they may overlap), backlash.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from lipsync.arrays import Array
from lipsync.markers import MARKERS_47

JAW = "jaw"
PROTRUSION = "lip_protrusion"

#: Which way each servo moves the skin for a positive angle. Left and right are the robot's own.
POSITIVE_DIRECTIONS: Mapping[str, str] = MappingProxyType(
    {
        JAW: "opens",
        "upper_lip_left": "raises",
        "upper_lip_right": "raises",
        "lower_lip_left": "lowers",
        "lower_lip_right": "lowers",
        "corner_left_out": "widens",
        "corner_left_up": "raises",
        "corner_right_out": "widens",
        "corner_right_up": "raises",
        PROTRUSION: "protrudes",
    }
)

#: The hinge lies this far behind and above the closed lips: Bonwill's triangle of the mandible has
#: sides of 4 inches (condyle, condyle, incisors), so the incisors are 88.0 mm from the hinge line,
#: tilted 26 degrees (Balkwill's angle): 79 mm back and 39 mm up, plus 11 mm of lip.
#: grid_s1 agrees: its chin and lower lip turn best about a line 37 mm above, 90 mm behind the lips.
JAW_AXIS_BEHIND_LIPS_MM = 90.0
JAW_AXIS_ABOVE_LIPS_MM = 39.0
#: Width of the blend from head to jaw across the cheek, per millimetre from the middle of the face:
#: chosen on grid_s1, where it is within 0.15 of the share of every cheek and jaw marker.
JAW_BLEND_WIDTH_PER_MM = 0.45
#: The smallest blend width: it only keeps the division finite in the middle, where nothing blends.
_MIN_BLEND_WIDTH_MM = 1.0

#: An 8 mm horn turns the 4 to 5 mm that lips travel against the jaw into 30 to 40 degrees: little
#: backlash (1 degree is 0.14 mm), and far from the dead point at 90 degrees.
HORN_ARM_MM = 8.0
#: Standard deviation of the Gaussian around an attachment; in grid_s1 the right cheek 15 to 17 mm
#: from the lip corner follows about 0.55 of the corner's sideways motion.
SKIN_WIDTH_MM = 14.0
#: Corners slide around the teeth: their way out turns back by 30 degrees from straight sideways.
_CORNER_OUT = (0.866, 0.0, -0.5)
#: Lips that come forward draw their corners together by this part of the way (design of this face).
_ROUNDING = 0.4

_UPPER_LIP = (39, 37, 0, 267, 269, 82, 13, 312)
_LOWER_LIP = (405, 314, 17, 84, 181, 317, 14, 87)
_CORNERS = (61, 291, 78, 308)


@dataclass(frozen=True, slots=True)
class _Horn:
    """A servo horn attached to a landmark of the skin.

    direction: of its pull, unit length; spares: landmarks that do not move with it.
    """

    landmark: int
    direction: tuple[float, float, float]
    spares: tuple[int, ...] = ()


_HORNS: Mapping[str, _Horn] = MappingProxyType(
    {
        "upper_lip_left": _Horn(269, (0.0, 1.0, 0.0), _LOWER_LIP),
        "upper_lip_right": _Horn(39, (0.0, 1.0, 0.0), _LOWER_LIP),
        "lower_lip_left": _Horn(405, (0.0, -1.0, 0.0), _UPPER_LIP),
        "lower_lip_right": _Horn(181, (0.0, -1.0, 0.0), _UPPER_LIP),
        "corner_left_out": _Horn(291, _CORNER_OUT),
        "corner_left_up": _Horn(291, (0.0, 1.0, 0.0)),
        "corner_right_out": _Horn(61, (-_CORNER_OUT[0], *_CORNER_OUT[1:])),
        "corner_right_up": _Horn(61, (0.0, 1.0, 0.0)),
    }
)


@dataclass(frozen=True, slots=True)
class SimulatedFace:
    """A simulated face with some of the servos in `POSITIVE_DIRECTIONS`.

    neutral_mm: (47, 3), all servos at 0. pulls: (n_servos, 47, 3), unit direction times weight of
    each horn; zero for the jaw. jaw_share: (47,), the share of the jaw's turn that a marker
    follows. jaw_axis_mm: (3,), a point of the hinge, which runs along x.
    """

    servo_names: tuple[str, ...]
    neutral_mm: Array
    pulls: Array
    jaw_share: Array
    jaw_axis_mm: Array


def simulated_face(neutral_mm: Array, servo_names: Sequence[str]) -> SimulatedFace:
    """Return the simulated face whose skin has the shape `neutral_mm`, lips closed.

    Parameters
    ----------
    neutral_mm : Array
        (47, 3) mm.
    servo_names : Sequence[str]
        Names of the n_servos servos.

    Returns
    -------
    SimulatedFace
        Simulated face, pulls per mm of horn travel.

    Raises
    ------
    ValueError
        A servo's name is unknown, or the shape is wrong.
    """
    if neutral_mm.shape != (len(MARKERS_47.landmarks), 3):
        raise ValueError(f"neutral_mm must have the shape (47, 3), not {neutral_mm.shape}")
    for name in servo_names:
        if name not in POSITIVE_DIRECTIONS:
            known = ", ".join(POSITIVE_DIRECTIONS)
            raise ValueError(f"servo {name!r} is not in the simulated face; it knows {known}")
    seam_mm = (neutral_mm[MARKERS_47.upper_lip] + neutral_mm[MARKERS_47.lower_lip]) / 2
    return SimulatedFace(
        servo_names=tuple(servo_names),
        neutral_mm=neutral_mm,
        pulls=np.array([_pull_per_mm(name, neutral_mm) for name in servo_names]).reshape(-1, 47, 3),
        jaw_share=_jaw_share(neutral_mm, seam_mm),
        jaw_axis_mm=seam_mm + np.array([0.0, JAW_AXIS_ABOVE_LIPS_MM, -JAW_AXIS_BEHIND_LIPS_MM]),
    )


def marker_positions_mm(face: SimulatedFace, positions_deg: Array) -> Array:
    """Return the markers of a simulated face in poses.

    Parameters
    ----------
    face : SimulatedFace
        The simulated face.
    positions_deg : Array
        (n, n_servos) degrees, in the order of `face.servo_names`.

    Returns
    -------
    Array
        (n, 47, 3) mm.
    """
    angles_rad = np.deg2rad(positions_deg)
    skin_mm = face.neutral_mm + np.tensordot(HORN_ARM_MM * np.sin(angles_rad), face.pulls, axes=1)
    if JAW not in face.servo_names:
        return np.asarray(skin_mm)
    opening_rad = angles_rad[:, face.servo_names.index(JAW), None]
    cos, sin = np.cos(opening_rad), np.sin(opening_rad)
    from_axis_mm = skin_mm - face.jaw_axis_mm
    y, z = from_axis_mm[..., 1], from_axis_mm[..., 2]
    # Opening turns about +x: what lies in front of the hinge goes down, what hangs below goes back.
    turned_mm = np.stack([from_axis_mm[..., 0], cos * y - sin * z, sin * y + cos * z], axis=-1)
    return np.asarray(skin_mm + face.jaw_share[:, None] * (turned_mm - from_axis_mm))


def _pull_per_mm(name: str, neutral_mm: Array) -> Array:
    """Return the motion of markers, (47, 3), for 1 mm of travel of the horn of the servo `name`."""
    if name == JAW:
        return np.zeros_like(neutral_mm)
    if name == PROTRUSION:
        return _protrusion_per_mm(neutral_mm)
    horn = _HORNS[name]
    attached_mm = neutral_mm[MARKERS_47.landmarks.index(horn.landmark)]
    weight = _gaussian(np.linalg.norm(neutral_mm - attached_mm, axis=1))
    weight[np.isin(MARKERS_47.landmarks, horn.spares)] = 0.0
    if horn.spares:  # a corner belongs to both lips, so half of it goes with either
        weight[np.isin(MARKERS_47.landmarks, _CORNERS)] /= 2
    return np.asarray(weight[:, None] * horn.direction)


def _protrusion_per_mm(neutral_mm: Array) -> Array:
    """Return the motion of protrusion, (47, 3): lips forward as one piece, corners inwards."""
    lips_mm = neutral_mm[list(MARKERS_47.lips)]
    distance_mm = np.linalg.norm(neutral_mm[:, None] - lips_mm, axis=2).min(axis=1)
    direction = np.zeros_like(neutral_mm)
    direction[:, 0] = -_ROUNDING * np.clip(_sideways(neutral_mm), -1.0, 1.0)
    direction[:, 2] = 1.0
    return np.asarray(_gaussian(distance_mm)[:, None] * direction)


def _jaw_share(neutral_mm: Array, seam_mm: Array) -> Array:
    """Return each marker's share of the jaw's turn, (47,): 0 = head, 1 = jaw.

    neutral_mm: (47, 3); seam_mm: (3,), the middle between the closed lips.

    Lips: parabolas that meet at one half in the corners. Skin: a logistic step in height at the
    lips, sharp in the middle of the face and broad towards the ears.
    """
    sideways = _sideways(neutral_mm)
    half_width_mm = _half_width_mm(neutral_mm)
    height_mm = neutral_mm[:, 1] - seam_mm[1]
    width_mm = JAW_BLEND_WIDTH_PER_MM * np.abs(sideways) * half_width_mm
    share = 1.0 / (1.0 + np.exp(height_mm / np.maximum(width_mm, _MIN_BLEND_WIDTH_MM)))
    parabola = 0.5 * np.minimum(sideways**2, 1.0)
    upper, lower, corners = (
        np.isin(MARKERS_47.landmarks, landmarks) for landmarks in (_UPPER_LIP, _LOWER_LIP, _CORNERS)
    )
    share[upper], share[lower], share[corners] = parabola[upper], 1.0 - parabola[lower], 0.5
    return np.asarray(share)


def _sideways(neutral_mm: Array) -> Array:
    """Return each marker's x, (47,), so scaled that the mouth's right corner is -1, the left 1."""
    right, left = (neutral_mm[MARKERS_47.landmarks.index(n), 0] for n in (61, 291))
    return np.asarray((neutral_mm[:, 0] - (left + right) / 2) / _half_width_mm(neutral_mm))


def _half_width_mm(neutral_mm: Array) -> float:
    right, left = (neutral_mm[MARKERS_47.landmarks.index(n), 0] for n in (61, 291))
    return float((left - right) / 2)


def _gaussian(distance_mm: Array) -> Array:
    return np.asarray(np.exp(-0.5 * (distance_mm / SKIN_WIDTH_MM) ** 2))
