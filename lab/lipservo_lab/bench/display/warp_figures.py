"""The warp of a photograph without a tracker: markers and folds, on faces that are known.

Three faces of different size and framing: the twin's own picture, the talker of grid_s1 by the
corpus's landmarks, and a small narrow face that looks aside. Motion: every recorded frame of
`random_test`.
"""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lipservo.display.lip_contact import areas_px2
from lipservo.display.photo_display import PhotoDisplay
from lipservo.display.photo_face import photo_face
from lipservo.display.photo_file import Landmarks, framed
from lipservo.display.photo_warp import rotation
from lipservo.display.shipped_faces import TWIN_SIZE, twin_landmarks
from lipsync.array_archive import ArrayArchive
from lipsync.arrays import Array
from lipsync.face.frame import Frame
from lipsync.face.model import FaceModel
from lipsync.twin.head_surface import N_SKIN, load_mean_face

SIZE = (640, 480)
#: The picture of the talker, and of which of its sentences the first frame is taken.
_GRID_SIZE, _GRID_SENTENCE = (360, 288), "bbbf9a"
_UNITS_PER_PIXEL = 64.0
#: Of the small face: share of the mean one's width and height, how it looks, and its place.
_NARROW, _YAW_PITCH_ROLL_DEG = np.array([0.82, 0.92, 0.9]), (10.0, -6.0, 8.0)
_SMALL_PX_PER_MM, _SMALL_AT_PX, _SMALL_SIZE = 1.1, (380.0, 190.0), (640, 480)
_CHECKED_FRAMES = 40


def known_faces(corpus: Path) -> dict[str, tuple[tuple[int, int], Landmarks]]:
    """Return for each face, by name, the size of its picture and its landmarks."""
    return {
        "twin": (TWIN_SIZE, twin_landmarks()),
        "grid_s1": (_GRID_SIZE, _corpus_landmarks(corpus)),
        "small": (_SMALL_SIZE, _small_face()),
    }


def warp_figures(
    face: FaceModel,
    faces: Mapping[str, tuple[tuple[int, int], Landmarks]],
    motions: Mapping[str, Array],
    advance: Callable[[str, int, int], None],
) -> dict[str, object]:
    """Warp each face through all motions; return its errors and folds, and the worst of all faces.

    Parameters
    ----------
    face : FaceModel
        The model.
    faces : Mapping[str, tuple[tuple[int, int], Landmarks]]
        Size and landmarks by name.
    motions : Mapping[str, Array]
        (n, n_components) of each sentence.
    advance : Callable[[str, int, int], None]
        Called with the progress.

    Returns
    -------
    dict[str, object]
        marker_error_px: the largest that `_marker_error_px` finds in some 40 frames. folds:
        triangles that turned over in all frames.
    """
    rows: list[dict[str, Any]] = []
    for name, (size, landmarks) in faces.items():
        blank = np.full((size[1], size[0], 3), 128, dtype=np.uint8)
        display = PhotoDisplay(photo_face(*framed(blank, landmarks, SIZE), face))
        folds, marker_errors_px = 0, [0.0]
        for number, motion in enumerate(motions.values()):
            advance(name, number, len(motions))
            folds += sum(_count_folds(display, Frame(0.0, coefficients)) for coefficients in motion)
            step = max(1, len(motions) * len(motion) // _CHECKED_FRAMES)
            for coefficients in motion[::step]:
                marker_errors_px.append(_marker_error_px(display, face, coefficients))
        rows.append(
            {
                "face": name,
                "marker_error_px": round(max(marker_errors_px), 3),
                "folds": folds,
                "frames": sum(map(len, motions.values())),
            }
        )
    worst = {"marker_error_px": max(row["marker_error_px"] for row in rows)}
    return {**worst, "folds": sum(row["folds"] for row in rows), "faces": rows}


def _count_folds(display: PhotoDisplay, frame: Frame) -> int:
    """Return how many triangles of the photograph's mesh a frame turns over."""
    mesh = display.warp.mesh
    before = areas_px2(mesh.rest_px, mesh.triangles)
    after = areas_px2(display.warp.moved(frame)[0], mesh.triangles)
    return int((np.sign(after) != np.sign(before)).sum())


def _marker_error_px(display: PhotoDisplay, face: FaceModel, coefficients: Array) -> float:
    """Return how far, on average in pixels, a warped photograph's markers are from the model's.

    The model's markers are the photograph's, moved as the model moves them from its own pose, in
    this head's size and turn. coefficients: (n_components,), one frame.
    """
    model_px, drawn_px = [], []
    moved = display.warp.moved(Frame(0.0, coefficients))[0]
    model_moves_px = display.model_moves_px(face, coefficients)
    for landmark, move in zip(face.layout.landmarks, model_moves_px, strict=True):
        vertex = display.warp.vertex_of(landmark) if landmark < N_SKIN else -1
        if vertex >= 0:
            model_px.append(display.warp.mesh.rest_px[vertex] + move)
            drawn_px.append(moved[vertex])
    return float(np.linalg.norm(np.array(model_px) - drawn_px, axis=1).mean())


def _corpus_landmarks(corpus: Path) -> Landmarks:
    """Return the tracked landmarks of one frame of the corpus, px by landmark number."""
    numbers = json.loads((corpus / "landmarks.json").read_text())["landmark_ids"]
    path = corpus / "landmarks" / f"{_GRID_SENTENCE}.npz"
    with path.open("rb") as file, ArrayArchive(file, 1 << 26) as archive:
        first_frame_px = archive["landmarks_64th_px"][0] / _UNITS_PER_PIXEL - (0.5, 0.5, 0.0)
    return dict(zip(numbers, first_frame_px, strict=True))


def _small_face() -> Landmarks:
    """Return landmarks, px, of the mean head: narrower, turned, small, not in the middle."""
    vertices_mm = load_mean_face().vertices_mm[:N_SKIN] * _NARROW
    yaw, pitch, roll = np.radians(_YAW_PITCH_ROLL_DEG)
    turned_px = vertices_mm @ rotation(pitch, yaw, roll).T * _SMALL_PX_PER_MM
    return dict(enumerate(turned_px * (1.0, -1.0, -1.0) + (*_SMALL_AT_PX, 0.0)))
