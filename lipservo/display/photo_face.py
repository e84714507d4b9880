"""A photograph of a face that a face model can move: the mean head fitted to its landmarks.

The mean head is fitted to the landmarks, by a similarity and then, as a thin shell, through each of
them. From it a twin is made (`lipsync/twin/twin.py`: a head with the model's motions, lids, brows,
smile, teeth and tongue), in the proportions of this face, whose skin is coloured by the photograph.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from lipsync.arrays import Array
from lipsync.errors import UserError
from lipsync.face.head_motion import apply_similarity, fit_similarity
from lipsync.face.model import FaceModel
from lipsync.markers import INNER_LIP
from lipsync.twin.head_surface import (
    LEFT_EYE,
    LEFT_IRIS,
    N_SKIN,
    RIGHT_EYE,
    RIGHT_IRIS,
    MeanFace,
    head_surface,
    load_mean_face,
    spread,
)
from lipsync.twin.twin import Twin, make_twin
from lipsync.video.face_detection import Picture

#: A face turned farther than this shows one side only, degrees of yaw and of pitch.
MOST_TURNED_DEG = 30.0
#: A smaller face has too few pixels for its lips, px from ear to ear.
LEAST_FACE_PX = 60.0
#: Points placed by hand in a photograph, which a fit needs at the least: names, and numbers in the
#: 478-point face mesh.
HAND_POINTS: Mapping[str, int] = {
    "right_eye_outer": 33, "right_eye_inner": 133, "left_eye_inner": 362, "left_eye_outer": 263,
    "right_lid_upper": 159, "right_lid_lower": 145, "left_lid_upper": 386, "left_lid_lower": 374,
    "nose_tip": 1, "nose_base": 2, "mouth_right": 61, "mouth_left": 291,
    "upper_lip_top": 0, "upper_lip_bottom": 13, "lower_lip_top": 14, "lower_lip_bottom": 17,
    "chin": 152, "right_ear": 234, "left_ear": 454, "forehead": 10,
}  # fmt: skip
#: Lips nearer than this in a photograph are closed: they rest.
_CLOSED_MM = 1.2
#: How far a measured lip gap may be off, mm.
_GAP_NOISE_MM = 0.4
#: Opposite landmarks of the inner lips, (upper, lower), from one corner to the other.
_LIP_PAIRS = tuple(zip(INNER_LIP[1:10], INNER_LIP[:10:-1], strict=True))


class PhotoError(UserError):
    """A photograph that cannot be moved; one line: which one, why, and the remedy."""


@dataclass(frozen=True, slots=True)
class LipGaps:
    """Distances of the model's inner lips, as a linear function of the coefficients.

    along (n,): position of each gap from one corner of the mouth (0) to the other (1). at_zero
    (n,): the gaps in mm at coefficients 0; each (n, n_components): their change in mm per
    coefficient. The gap at both corners is always 0.
    """

    along: Array
    at_zero: Array
    each: Array

    def gaps_mm(self, coefficients: Array) -> Array:
        """Return the lip gaps of a mouth shape.

        Parameters
        ----------
        coefficients : Array
            (n_components,).

        Returns
        -------
        Array
            (n,) mm, at the positions `self.along`.
        """
        return np.asarray(self.at_zero + self.each @ coefficients)

    def at(self, along: Array, coefficients: Array) -> Array:
        """Return the lip gaps at given positions along the lips, interpolated.

        Parameters
        ----------
        along : Array
            (k,), 0 to 1 from corner to corner.
        coefficients : Array
            (n_components,).

        Returns
        -------
        Array
            (k,) mm.
        """
        known = np.concatenate([[0.0], self.along, [1.0]])
        gaps = np.concatenate([[0.0], self.gaps_mm(coefficients), [0.0]])
        return np.asarray(np.interp(along, known, gaps))


@dataclass(frozen=True, slots=True)
class PhotoFace:
    """A photograph with a head fitted to it.

    picture (height, width, 3). twin: the head, in mm. own (n_components,): the coefficients at
    which the head is as photographed. matrix (3, 3), shift_px (3,): `places_mm @ matrix.T +
    shift_px` are pixels, x right, y down and z towards the viewer, a pixel's middle at whole
    numbers. lip_gaps: of the model.
    """

    picture: Picture
    twin: Twin
    own: Array
    lip_gaps: LipGaps
    matrix: Array
    shift_px: Array

    @property
    def px_per_mm(self) -> float:
        """Scale of the face in the picture, in pixels per mm."""
        return float(np.cbrt(abs(np.linalg.det(self.matrix))))

    def in_picture(self, places_mm: Array) -> Array:
        """Convert positions on the head to pixels and depth in the picture.

        Parameters
        ----------
        places_mm : Array
            (n, 3) mm.

        Returns
        -------
        Array
            (n, 3) pixels: x right, y down, z towards the viewer.
        """
        return np.asarray(places_mm @ self.matrix.T + self.shift_px)


def photo_face(picture: Picture, landmarks_px: Mapping[int, Array], face: FaceModel) -> PhotoFace:
    """Fit the mean head to a photograph and return both, ready to be moved by the model.

    Parameters
    ----------
    picture : Picture
        (height, width, 3).
    landmarks_px : Mapping[int, Array]
        By number in the 478-point face mesh (2,) or (3,), x right, y down, z away from the viewer;
        all points of a tracker, or at least the points placed by hand, `HAND_POINTS`.
    face : FaceModel
        The model that will move the head.

    Returns
    -------
    PhotoFace
        With its scale in pixels per mm.

    Raises
    ------
    PhotoError
        The photograph cannot be used.
    TwinError
        The model's points are not numbered as in the 478-point face mesh.
    """
    missing = [name for name, number in HAND_POINTS.items() if number not in landmarks_px]
    if missing:
        raise PhotoError(f"landmark {HAND_POINTS[missing[0]]} ({missing[0]}) is missing; add it")
    # The landmarks on the mean head (mm) and in the picture (pixels, y up, z to the viewer).
    mean = load_mean_face()
    numbers = sorted(number for number in landmarks_px if number < N_SKIN)
    head_mm = mean.vertices_mm[numbers]
    in_picture = _with_depth([np.asarray(landmarks_px[n], dtype=np.float64) for n in numbers])
    is_flat = in_picture is None
    if in_picture is None:
        flat = np.array([landmarks_px[n][:2] for n in numbers], dtype=np.float64)
        in_picture = np.column_stack([flat * (1.0, -1.0), np.zeros(len(flat))])
    # The scale, rotation and shift from head to picture; points without depth get the mean head's.
    reference = head_mm * (1.0, 1.0, 0.0) if is_flat else head_mm
    scale, rotation, shift = (each[0] for each in fit_similarity(reference[None], in_picture))
    if is_flat:
        in_picture[:, 2] = scale * head_mm[:, 2]
    _check_size_and_pose(scale * np.ptp(mean.vertices_mm[:N_SKIN, 0]), rotation)
    # The way back, by which the landmarks of this face come to millimetres of the head.
    to_head = (np.array([1 / scale]), rotation.T[None], -(shift @ rotation)[None] / scale)
    own_mm = apply_similarity(in_picture[None], *to_head)[0]
    # The mean head bent so that its landmarks are this face's, and its mouth as photographed.
    fitted = _fitted_head(mean, numbers, own_mm, landmarks_px, to_head)
    gaps = lip_gaps(face)
    own = _photographed_coefficients(face, gaps, fitted)
    # The picture's y points down.
    mirror = np.array([1.0, -1.0, 1.0])
    matrix = mirror[:, None] * scale * rotation
    return PhotoFace(picture, make_twin(face, fitted, own), own, gaps, matrix, mirror * shift)


def _with_depth(points: list[Array]) -> Array | None:
    """Return the points as (n, 3), y up and z to the viewer; None if any has no depth."""
    if any(len(point) < 3 for point in points):
        return None
    return np.stack(points) * (1.0, -1.0, -1.0)


def _check_size_and_pose(face_px: float, rotation: Array) -> None:
    """Raise PhotoError for a face under 60 px (`face_px`), or turned more than 30 degrees."""
    if face_px < LEAST_FACE_PX:
        raise PhotoError(
            f"the face is {face_px:.0f} pixels wide, but {LEAST_FACE_PX:.0f} are needed; take a "
            "larger picture, or go nearer"
        )
    ahead = rotation[:, 2]
    yaw_deg = float(np.degrees(np.arctan2(ahead[0], ahead[2])))
    pitch_deg = float(np.degrees(np.arctan2(ahead[1], ahead[2])))
    for turned_deg, how in ((yaw_deg, "aside"), (pitch_deg, "up or down")):
        if abs(turned_deg) > MOST_TURNED_DEG:
            raise PhotoError(
                f"the face is turned {how} by {abs(turned_deg):.0f} degrees, but at most "
                f"{MOST_TURNED_DEG:.0f} are possible; take a picture from the front"
            )


def _fitted_head(
    mean: MeanFace,
    numbers: list[int],
    own_mm: Array,
    landmarks_px: Mapping[int, Array],
    to_head: tuple[Array, Array, Array],
) -> MeanFace:
    """Return the mean head with its landmarks `numbers` at `own_mm`, the rest following smoothly.

    own_mm: (n, 3), the photographed landmarks on the head. landmarks_px: for the irises, which
    `to_head` (scale, rotation, shift) brings from pixels to mm.
    """
    surface = head_surface(mean)
    # The back of the head stays; between it and the landmarks the surface bends like a shell.
    given_vertices = np.concatenate([numbers, np.flatnonzero(mean.behind > 2.0)])
    moves_mm = np.zeros((len(given_vertices), 3))
    moves_mm[: len(numbers)] = own_mm - mean.vertices_mm[numbers]
    places = mean.vertices_mm + spread(surface.stiffness, given_vertices, moves_mm)
    irises = mean.irises_mm.copy()
    for side, (iris, rim) in enumerate(((RIGHT_IRIS, RIGHT_EYE), (LEFT_IRIS, LEFT_EYE))):
        # Tracked irises are used; others move with their eye's rim.
        if all(number in landmarks_px and len(landmarks_px[number]) == 3 for number in iris):
            iris_px = np.stack([landmarks_px[number] for number in iris]) * (1.0, -1.0, -1.0)
            irises[side] = apply_similarity(iris_px[None], *to_head)[0]
        else:
            rim_move_mm = places[list(rim)].mean(axis=0) - mean.vertices_mm[list(rim)].mean(axis=0)
            irises[side] = mean.irises_mm[side] + rim_move_mm
    return MeanFace(places, mean.triangles, mean.behind, irises)


def lip_gaps(face: FaceModel) -> LipGaps:
    """Return the gaps along a model's lips; one gap in the middle if it has no inner lips."""
    landmarks = face.layout.landmarks
    # Of each pair that the model has: its position from corner to corner, and both points' indices.
    pairs = [
        (n / (len(_LIP_PAIRS) + 1), landmarks.index(upper), landmarks.index(lower))
        for n, (upper, lower) in enumerate(_LIP_PAIRS, start=1)
        if upper in landmarks and lower in landmarks
    ] or [(0.5, face.layout.upper_lip, face.layout.lower_lip)]
    along, upper, lower = (np.array(each) for each in zip(*pairs, strict=True))
    upper, lower = upper.astype(int), lower.astype(int)
    mean = face.mean_mm[upper, 1] - face.mean_mm[lower, 1] - face.lips_touching_mm[1]
    basis = face.basis.reshape(face.n_components, -1, 3)[:, :, 1]
    return LipGaps(along, mean, (basis[:, upper] - basis[:, lower]).T)


def _photographed_coefficients(face: FaceModel, gaps: LipGaps, fitted: MeanFace) -> Array:
    """Return the coefficients of the mouth in a photograph, (n_components,).

    The rest if the lips are closed; else, of all mouths with these lip gaps, the likeliest by the
    model's covariance (the conditional mean of a Gaussian). Proportions that differ from the
    speaker's are not counted as motion. fitted: the head fitted to the photograph.
    """
    upper, lower = (list(each) for each in zip(*_LIP_PAIRS, strict=True))
    gaps_mm = fitted.vertices_mm[upper, 1] - fitted.vertices_mm[lower, 1]
    if gaps_mm.max() < _CLOSED_MM:
        return face.rest
    along = np.arange(1, len(gaps_mm) + 1) / (len(gaps_mm) + 1)
    # How much wider the photographed gaps are than the model's at rest.
    wider_mm = np.interp(gaps.along, along, gaps_mm) - gaps.gaps_mm(face.rest)
    gain = face.covariance @ gaps.each.T
    noise = np.eye(len(wider_mm)) * _GAP_NOISE_MM**2
    return np.asarray(face.rest + gain @ np.linalg.solve(gaps.each @ gain + noise, wider_mm))
