"""Tracks from face landmarks: a folder laid out like `grid_s1` (see corpus/grid.py)."""

import json
from pathlib import Path

import numpy as np

from lipservo_lab.corpus.grid import read_landmarks, sentence_names
from lipservo_lab.corpus.utterance import CorpusError
from lipservo_lab.learning.expression.tracks import (
    LEAST_FRAMES,
    ExpressionTrack,
    Progress,
    TrackError,
    at_model_rate,
    no_progress,
)
from lipsync.arrays import Array
from lipsync.face.head_motion import apply_similarity, fit_similarity, refine_mean

#: Outer and inner corner of the eye, iris, upper and lower lid; the face's left eye first.
_EYES = {
    "lid_left": (263, 362, 473, (387, 386, 385), (373, 374, 380)),
    "lid_right": (33, 133, 468, (160, 159, 158), (144, 145, 153)),
}
_EYE_DISTANCE_MM = 90.0
#: Radius of an eyeball, at the size of a face whose outer eye corners are 90 mm apart.
_EYEBALL_MM = 12.0
#: Lids at rest, and shut: percentiles of how far they are apart over all recordings.
_OPEN_PERCENTILE, _SHUT_PERCENTILE = 60.0, 0.5
#: With lids shut further than this a tracker guesses where the iris is.
_SEES_BELOW = 0.35
#: Every so many recordings make the mean head.
_MEAN_OF = 5


def read_grid_tracks(folder: Path, progress: Progress = no_progress) -> list[ExpressionTrack]:
    """Head, gaze and lids of every recording. Raises CorpusError, TrackError.

    Head: the rotation of the rigid points against their mean, from the usual pose. Gaze: irises
    between the corners of the eyes, from where they usually are. Lids: their distance over the
    width of the eye, 0 at its usual value, 1 at its least.
    """
    rows, rigid, rate_hz = _read_rows(folder)
    names = sentence_names(folder)
    if not names:
        raise TrackError(f"{folder}: no recordings; docs/expression-voice.md says what is read")
    points: list[Array] = []
    for number, name in enumerate(names, start=1):
        points.append(read_landmarks(folder / "landmarks" / f"{name}.npz", len(rows)))
        progress("reading", number, len(names))
    rigid_rows = [rows[n] for n in rigid]
    eyes = (rigid.index(33), rigid.index(263), _EYE_DISTANCE_MM)
    mean = refine_mean(np.concatenate([p[:, rigid_rows] for p in points[::_MEAN_OF]]), eyes)
    found = [_measure(p, rows, rigid_rows, mean) for p in points]
    every = {name: np.concatenate([each[name] for each in found]) for name in found[0]}
    rest = {name: float(np.median(values)) for name, values in every.items()}
    for name in _EYES:
        rest[name] = float(np.percentile(every[name], _OPEN_PERCENTILE))
    shut = {name: float(np.percentile(every[name], _SHUT_PERCENTILE)) for name in _EYES}
    tracks = []
    for name, raw in zip(names, found, strict=True):
        values = {key: each - rest[key] for key, each in raw.items()}
        for lid in _EYES:
            values[lid] = (rest[lid] - raw[lid]) / max(1e-6, rest[lid] - shut[lid])
        _bridge_blinks(values)
        times_s = np.arange(len(raw["neck_yaw_deg"])) / rate_hz
        values = at_model_rate(times_s, values)
        if len(values["neck_yaw_deg"]) >= LEAST_FRAMES:
            tracks.append(ExpressionTrack(name, values, folder / "audio" / f"{name}.flac"))
    return tracks


def head_angles_deg(rotations: Array) -> tuple[Array, Array, Array]:
    """Return the angles of head orientations, in the signs of `Expression`.

    x to the picture's right, which is the face's own left, y up, z to the viewer; yaw, then pitch,
    then roll.

    Parameters
    ----------
    rotations : Array
        (n, 3, 3).

    Returns
    -------
    tuple[Array, Array, Array]
        (n,) degrees each: pitch, yaw, roll.
    """
    forward, up = rotations[:, :, 2], rotations[:, 1]
    pitch = np.degrees(np.arcsin(np.clip(forward[:, 1], -1.0, 1.0)))
    yaw = np.degrees(np.arctan2(forward[:, 0], forward[:, 2]))
    roll = np.degrees(np.arctan2(-up[:, 0], up[:, 1]))
    return pitch, yaw, roll


def _measure(
    points: Array, rows: dict[int, int], rigid: list[int], mean: Array
) -> dict[str, Array]:
    scale, rotation, translation = fit_similarity(points[:, rigid], mean)
    # `rotation` brings the picture's head to the mean one; the head's own is its inverse.
    pitch, yaw, roll = head_angles_deg(rotation.transpose(0, 2, 1))
    values = {"neck_pitch_deg": pitch, "neck_yaw_deg": yaw, "neck_roll_deg": roll}
    still = apply_similarity(points, scale, rotation, translation)
    seen = []
    for lid, (outer, inner, iris, upper, lower) in _EYES.items():
        width = np.linalg.norm(still[:, rows[outer]] - still[:, rows[inner]], axis=1)
        apart = [
            np.linalg.norm(still[:, rows[u]] - still[:, rows[low]], axis=1)
            for u, low in zip(upper, lower, strict=True)
        ]
        values[lid] = np.mean(apart, axis=0) / width
        seen.append(still[:, rows[iris]] - 0.5 * (still[:, rows[outer]] + still[:, rows[inner]]))
    sines = np.clip(np.mean(seen, axis=0)[:, :2] / _EYEBALL_MM, -1.0, 1.0)
    values["eye_yaw_deg"], values["eye_pitch_deg"] = np.degrees(np.arcsin(sines)).T
    return values


def _bridge_blinks(values: dict[str, Array]) -> None:
    """Gaze is interpolated where the lids hide the iris."""
    sees = np.maximum(values["lid_left"], values["lid_right"]) < _SEES_BELOW
    if sees.any() and not sees.all():
        frames = np.arange(len(sees))
        for name in ("eye_yaw_deg", "eye_pitch_deg"):
            values[name] = np.interp(frames, frames[sees], values[name][sees])


def _read_rows(folder: Path) -> tuple[dict[int, int], list[int], float]:
    """Row of each landmark, the landmarks that are fixed to bone, frames a second."""
    path = folder / "landmarks.json"
    try:
        content = json.loads(path.read_text())
        rows = {int(number): row for row, number in enumerate(content["landmark_ids"])}
        rigid = [int(number) for number in content["groups"]["rigid"]]
        rate_hz = float(content["frame_rate_hz"])
    except FileNotFoundError:
        raise CorpusError(f"{path}: no such file") from None
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise CorpusError(f"{path}: not a usable landmark list ({error})") from error
    needed = {n for eye in _EYES.values() for n in (*eye[:3], *eye[3], *eye[4])} | set(rigid)
    if missing := sorted(needed - set(rows)):
        raise TrackError(
            f"{path}: landmark_ids lacks {', '.join(map(str, missing[:5]))}: lids and irises are "
            "needed; number points as the 478-point face mesh does"
        )
    if not {33, 263} <= set(rigid) or not rate_hz > 0.0:
        raise TrackError(f"{path}: rigid points without 33 and 263, or no frame rate")
    return rows, rigid, rate_hz
