"""Whether a face was tracked well enough to learn from, and figures and reasons for a report."""

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from lipservo_lab.video.face_track import FaceTrack
from lipsync.arrays import Array


@dataclass(frozen=True, slots=True)
class ClipReport:
    """What became of one clip, or of one part of a long one.

    left_out: why it is not in the corpus; None: it is. notes: what was corrected or is doubtful.
    phonemes: `text` or `recognised`. text_score: as of `lipservo lines align`. shift_ms: how much
    later than the picture the sound is; corrected_ms: by how much it was moved. gap_r: correlation
    of the tracked lip gap with the one that the shipped model predicts from the sound, after the
    correction. Angles: the head's, medians over the pictures.
    """

    clip: str
    left_out: str | None = None
    notes: tuple[str, ...] = ()
    seconds: float = 0.0
    phonemes: str | None = None
    text_score: float | None = None
    shift_ms: int | None = None
    corrected_ms: int | None = None
    gap_r: float | None = None
    eye_distance_px: float | None = None
    yaw_deg: float | None = None
    pitch_deg: float | None = None

    def as_json(self) -> dict[str, object]:
        """Return the fields by name."""
        return asdict(self)


#: Pairs of points, right and left at equal distance: outer eye corners, temples, ears.
_ACROSS = ((33, 263), (127, 356), (234, 454))
#: Forehead and chin: the line along the face.
_FOREHEAD, _CHIN = 10, 152
_RIGHT_EYE, _LEFT_EYE = 33, 263
#: With two faces in more than this share of the pictures it is unknown who speaks.
_MOST_DOUBLE = 0.1
#: Beyond these angles the lips are seen from the side, from above or from below, and hide each
#: other.
_MOST_YAW_DEG, _MOST_PITCH_DEG = 30.0, 35.0
#: Largest share of pictures beyond these angles.
_MOST_TURNED = 0.1
#: With fewer pixels between the eye corners lips move by less than one; grid_s1 has 67.
_LEAST_EYE_DISTANCE_PX = 35.0
#: Longest time without a face: a whole closure may be in a longer one.
LONGEST_HOLE_S = 0.1
#: Slower pictures do not show closures, which last 60 ms.
_SLOWEST_HZ = 20.0
_ROUNDING_S = 1e-3


@dataclass(frozen=True, slots=True)
class TrackQuality:
    """Medians over the pictures with a face, and the share of those (seen)."""

    eye_distance_px: float
    yaw_deg: float
    pitch_deg: float
    seen: float


def quality_of(track: FaceTrack) -> TrackQuality:
    """Return the figures of a track; NaN if no picture has a face."""
    has_face = track.n_faces > 0
    if not has_face.any():
        return TrackQuality(np.nan, np.nan, np.nan, 0.0)
    points = track.points[has_face].astype(float)
    yaw_deg, pitch_deg = _angles_deg(points)
    return TrackQuality(
        float(np.median(_eye_distances_px(points))),
        float(np.median(yaw_deg)),
        float(np.median(pitch_deg)),
        float(has_face.mean()),
    )


def usable_pictures(track: FaceTrack) -> NDArray[np.bool_]:
    """Return which pictures show exactly one face, not turned away, (n,)."""
    usable: NDArray[np.bool_] = track.n_faces == 1
    has_face = track.n_faces > 0
    usable[has_face] &= ~_is_turned(track.points[has_face].astype(float))
    return usable


def track_fault(track: FaceTrack, median_step_s: float) -> str | None:
    """Return why a corpus cannot use these pictures, and what to do; None if it can.

    median_step_s: usual time from picture to picture of the video.
    """
    fault = picture_fault(track, median_step_s)
    return fault or _hole(track.times_s, track.times_s[track.n_faces > 0])


def picture_fault(track: FaceTrack, median_step_s: float) -> str | None:
    """Return what is wrong with the pictures, as `track_fault`, but allow times without a face."""
    n, has_face = len(track.times_s), track.n_faces > 0
    if n < 2:
        return "holds fewer than two pictures; film longer"
    if median_step_s > 1.0 / _SLOWEST_HZ + _ROUNDING_S:
        return (
            f"{1.0 / median_step_s:.1f} pictures a second; film at {_SLOWEST_HZ:.0f} or more, with "
            "more light"
        )
    if not has_face.any():
        return "no face in any picture; film the face from the front, well lit"
    n_double = int((track.n_faces > 1).sum())
    if n_double > _MOST_DOUBLE * n:
        return f"two faces in {n_double} of {n} pictures; film one person alone"
    points = track.points[has_face].astype(float)
    n_turned = int(_is_turned(points).sum())
    if n_turned > _MOST_TURNED * n:
        yaw_deg, pitch_deg = (float(np.median(np.abs(each))) for each in _angles_deg(points))
        return (
            f"turned away in {n_turned} of {n} pictures ({yaw_deg:.0f} degrees sideways, "
            f"{pitch_deg:.0f} up or down in the middle); look into the camera"
        )
    eyes_px = float(np.median(_eye_distances_px(points)))
    if eyes_px < _LEAST_EYE_DISTANCE_PX:
        return (
            f"the face is too small: {eyes_px:.0f} pixels between the outer eye corners, at least "
            f"{_LEAST_EYE_DISTANCE_PX:.0f} are needed; go nearer or film larger"
        )
    return None


def _hole(times_s: Array, seen_s: Array) -> str | None:
    """Return a description of the longest time without a face if it is too long, else None.

    times_s: of all pictures; seen_s: of those with a face.
    """
    known_s = np.concatenate(([times_s[0]], seen_s, [times_s[-1]]))
    steps_s = np.diff(known_s)
    longest = int(steps_s.argmax())
    if steps_s[longest] <= LONGEST_HOLE_S + _ROUNDING_S:
        return None
    return (
        f"no face from {known_s[longest] - times_s[0]:.2f} to "
        f"{known_s[longest + 1] - times_s[0]:.2f} s; keep it in the picture and hands off it"
    )


def _is_turned(points: Array) -> NDArray[np.bool_]:
    """Return which faces are turned beyond the angles at which lips are seen, (n,)."""
    yaw_deg, pitch_deg = _angles_deg(points)
    turned: NDArray[np.bool_] = np.abs(yaw_deg) > _MOST_YAW_DEG
    return turned | (np.abs(pitch_deg) > _MOST_PITCH_DEG)


def _angles_deg(points: Array) -> tuple[Array, Array]:
    """Return yaw and pitch, (n,) each, of faces (n, 478, 3), by the depths that tracking gives."""
    across = np.sum([points[:, left] - points[:, right] for right, left in _ACROSS], axis=0)
    along = points[:, _CHIN] - points[:, _FOREHEAD]
    yaw = np.arctan2(across[:, 2], np.hypot(across[:, 0], across[:, 1]))
    pitch = np.arctan2(along[:, 2], np.hypot(along[:, 0], along[:, 1]))
    return np.degrees(yaw), np.degrees(pitch)


def _eye_distances_px(points: Array) -> Array:
    distances: Array = np.linalg.norm(points[:, _LEFT_EYE] - points[:, _RIGHT_EYE], axis=1)
    return distances
