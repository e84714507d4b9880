"""The warp of a photograph without a tracker: rest, markers and folds, on faces that are known.

Three faces of different size and framing: the twin's own picture, the talker of grid_s1 by the
corpus's landmarks, and a small narrow face that looks aside. Motion: every recorded frame of
`random_test`.
"""

import json
from collections.abc import Callable, Mapping
from pathlib import Path

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
    """Size of the picture and landmarks of each face, by name."""
    return {
        "twin": (TWIN_SIZE, twin_landmarks()),
        "grid_s1": (_GRID_SIZE, _stored(corpus)),
        "small": (_SMALL_SIZE, _small()),
    }


def warp_figures(
    face: FaceModel,
    faces: Mapping[str, tuple[tuple[int, int], Landmarks]],
    motions: Mapping[str, Array],
    advance: Callable[[str, int, int], None],
) -> dict[str, object]:
    """Return rest_error_px, marker_error_px and folds, of each face and the worst.

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
        Errors in pixels.
    """
    rows = []
    for name, (size, landmarks) in faces.items():
        blank = np.full((size[1], size[0], 3), 128, dtype=np.uint8)
        display = PhotoDisplay(photo_face(*(cut := framed(blank, landmarks, SIZE)), face))
        folds, markers = 0, [0.0]
        for n, shown in enumerate(motions.values()):
            advance(name, n, len(motions))
            folds += sum(_folds(display, Frame(0.0, each)) for each in shown)
            step = max(1, len(motions) * len(shown) // _CHECKED_FRAMES)
            for each in shown[::step]:
                markers.append(_marker_error_px(display, face, each))
        rows.append(
            {
                "face": name,
                "face_px": round(float(np.ptp([at[0] for at in cut[1].values()])), 1),
                "rest_error_px": round(_rest_error_px(display, cut[1]), 3),
                "marker_error_px": round(max(markers), 3),
                "folds": folds,
                "frames": sum(map(len, motions.values())),
            }
        )
    worst = {key: max(row[key] for row in rows) for key in ("rest_error_px", "marker_error_px")}  # type: ignore[type-var]
    return {**worst, "folds": sum(int(str(row["folds"])) for row in rows), "faces": rows}


def _folds(display: PhotoDisplay, frame: Frame) -> int:
    mesh = display.warp.mesh
    before = areas_px2(mesh.rest_px, mesh.triangles)
    after = areas_px2(display.warp.moved(frame)[0], mesh.triangles)
    return int((np.sign(after) != np.sign(before)).sum())


def _rest_error_px(display: PhotoDisplay, landmarks: Landmarks) -> float:
    """Return the largest distance between a landmark and where it is drawn, in the own pose."""
    frame = Frame(0.0, display.own)
    moved = display.warp.moved(frame)[0]
    numbers = [n for n in landmarks if n < N_SKIN and display.warp.vertex_of(n) >= 0]
    at = np.stack([moved[display.warp.vertex_of(n)] for n in numbers])
    wanted = np.stack([landmarks[n][:2] for n in numbers])
    drawn = _source(display, moved, wanted) - wanted
    return float(
        max(np.linalg.norm(at - wanted, axis=1).max(), np.linalg.norm(drawn, axis=1).max())
    )


def _marker_error_px(display: PhotoDisplay, face: FaceModel, coefficients: Array) -> float:
    """Return how far, on average in pixels, a warped photograph's markers are from the model's.

    The model's markers are the photograph's, moved as the model moves them from its own pose, in
    this head's size and turn. coefficients: (n_components,), one frame.
    """
    wanted, drawn = [], []
    moved = display.warp.moved(Frame(0.0, coefficients))[0]
    model = display.model_moves_px(face, coefficients)
    for landmark, move in zip(face.layout.landmarks, model, strict=True):
        vertex = display.warp.vertex_of(landmark) if landmark < N_SKIN else -1
        if vertex >= 0:
            wanted.append(display.warp.mesh.rest_px[vertex] + move)
            drawn.append(moved[vertex])
    return float(np.linalg.norm(np.array(wanted) - drawn, axis=1).mean())


def _source(display: PhotoDisplay, moved: Array, at_px: Array) -> Array:
    """Return where the photograph is sampled at places (n, 2), interpolated between pixels."""
    from scipy.ndimage import map_coordinates

    maps = display.source_of(moved)
    inside = at_px - display.corner_px
    return np.stack(
        [map_coordinates(layer, inside.T[::-1], order=1, mode="nearest") for layer in maps], axis=1
    )


def _stored(corpus: Path) -> Landmarks:
    numbers = json.loads((corpus / "landmarks.json").read_text())["landmark_ids"]
    path = corpus / "landmarks" / f"{_GRID_SENTENCE}.npz"
    with path.open("rb") as file, ArrayArchive(file, 1 << 26) as archive:
        first = archive["landmarks_64th_px"][0] / _UNITS_PER_PIXEL - (0.5, 0.5, 0.0)
    return dict(zip(numbers, first, strict=True))


def _small() -> Landmarks:
    """The mean head, narrower, turned, small, and away from the picture's middle."""
    places = load_mean_face().vertices_mm[:N_SKIN] * _NARROW
    yaw, pitch, roll = np.radians(_YAW_PITCH_ROLL_DEG)
    turned = places @ rotation(pitch, yaw, roll).T * _SMALL_PX_PER_MM
    return dict(enumerate(turned * (1.0, -1.0, -1.0) + (*_SMALL_AT_PX, 0.0)))
