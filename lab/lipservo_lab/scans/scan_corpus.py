"""Registered takes as a corpus folder (docs/motion.md, A corpus of your own), or as one archive."""

import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import soundfile
from numpy.typing import NDArray

from lipservo_lab.scans.head_alignment import Template
from lipservo_lab.scans.scan_import import RegisteredTake
from lipservo_lab.scans.takes import TakeSound
from lipservo_lab.video.face_track import RIGID
from lipsync.array_archive import about_in
from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.output_file import write_whole
from lipsync.textgrid import write_tiers

#: A corpus stores 64ths: here of a millimetre.
_UNITS_PER_MM = 64.0
#: A corpus has y down and z into the picture.
_TO_PICTURE_AXES = np.array([1.0, -1.0, -1.0])
_RIGHT_EYE, _LEFT_EYE = 33, 263
#: Folds for cross-validation by `lipservo bench motion`, and the sentences that these need.
_FOLDS, _LEAST_FOR_FOLDS = 5, 10
_KIND = "lipservo registered scans"


class CorpusWriter:
    """Writes takes, one after the other, into a new folder.

    place: the folder, empty. rate_hz: scans a second.
    """

    def __init__(self, place: Path, template: Template, rate_hz: float) -> None:
        self._place = place
        self._template = template
        self._rate_hz = rate_hz
        self._names: list[str] = []
        for name in ("audio", "landmarks", "labels"):
            (place / name).mkdir()

    def add(self, registered: RegisteredTake, sound: TakeSound) -> None:
        """Write the points, sound and labels of one take as a sentence."""
        name = registered.take.name
        units = np.rint(registered.points_mm * _TO_PICTURE_AXES * _UNITS_PER_MM)
        fits_int16 = np.abs(units).max() <= np.iinfo(np.int16).max
        points = units.astype(np.int16 if fits_int16 else np.int32)
        np.savez_compressed(self._place / "landmarks" / f"{name}.npz", landmarks_64th_px=points)
        soundfile.write(self._place / "audio" / f"{name}.flac", sound.samples, SAMPLE_RATE_HZ)
        write_tiers(self._place / "labels" / f"{name}.TextGrid", sound.tiers)
        self._names.append(name)

    def finish(self, about: Mapping[str, object]) -> None:
        """Write the files that all sentences share: landmarks, layout, splits, mesh, import.json.

        about: content of import.json.
        """
        template = self._template
        eyes = template.vertices_mm[template.rows_of((_RIGHT_EYE, _LEFT_EYE))]
        landmarks = {
            "frame_rate_hz": self._rate_hz,
            "landmark_ids": template.landmarks.tolist(),
            "eye_distance_mm": round(float(np.linalg.norm(eyes[0] - eyes[1])), 3),
            "groups": {"rigid": list(RIGID)},
        }
        self._json("landmarks.json", landmarks)
        self._json("layout.json", template.layout.description())
        self._json("import.json", about)
        if len(self._names) >= _LEAST_FOR_FOLDS:
            folds = [self._names[first::_FOLDS] for first in range(_FOLDS)]
            self._json("splits.json", {"folds": folds, "new_words": {}})
        np.savez_compressed(self._place / "mesh.npz", allow_pickle=False, **_mesh(template))

    def _json(self, name: str, content: Mapping[str, object]) -> None:
        text = json.dumps(content, indent=1) + "\n"
        (self._place / name).write_text(text, encoding="utf-8")


def write_motion(
    path: Path,
    takes: Sequence[RegisteredTake],
    template: Template,
    rate_hz: float,
    about: Mapping[str, object],
) -> None:
    """Write all takes end to end into one archive, whole or not at all. Raises OutputError.

    Arrays: about (n_bytes,), JSON; points_mm (n_frames, n_vertices, 3); borders (n_takes + 1,), the
    first frame of each take, and the number of frames; named_points (n_names,), the vertex of each
    name in `about`. The mesh: vertices_mm (n_vertices, 3) at rest; triangles (n_triangles, 3),
    vertices; landmarks (n_vertices,), the landmark number of each.
    """
    header = {
        "kind": _KIND,
        "rate_hz": rate_hz,
        "takes": [each.take.name for each in takes],
        "names": template.layout.names,
        **about,
    }
    rows = template.rows_of(template.layout.landmarks)
    buffer = io.BytesIO()
    arrays: dict[str, NDArray[Any]] = {
        "about": np.frombuffer(json.dumps(header).encode(), dtype=np.uint8),
        "points_mm": np.concatenate([each.points_mm for each in takes]),
        "borders": np.cumsum([0, *(len(each.points_mm) for each in takes)]),
        "named_points": rows,
        **_mesh(template),
    }
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    write_whole(path, buffer.getvalue())


def is_motion(head: bytes) -> bool:
    """Whether a file that begins so looks like one of `write_motion`."""
    return _KIND.encode() in about_in(head)


def _mesh(template: Template) -> dict[str, NDArray[Any]]:
    return {
        "vertices_mm": template.vertices_mm.astype(np.float32),
        "triangles": template.triangles.astype(np.int32),
        "landmarks": template.landmarks.astype(np.int32),
    }
