"""What `lipservo bench face` says of the twin's mesh."""

import time
from dataclasses import dataclass

import numpy as np

from lipsync.face.model import FaceModel
from lipsync.twin.head_surface import head_surface
from lipsync.twin.mean_face import load_mean_face
from lipsync.twin.packed import pack, unpack
from lipsync.twin.twin import make_twin, skin_morphs, worn_face

_FACES = 500


@dataclass(frozen=True, slots=True)
class TwinFigures:
    """Measured on this computer.

    triangles: of the skin. deform_precompute_s: from the surface to the targets of all
    components, the best of three. deform_frame_ms: one frame of the skin on the processor, float32,
    the median. marker_error_mm: the greatest distance of a marker's vertex from its marker in 500
    faces as likely as in speech, of what a page gets. least_weight, greatest_weight: of the shell.
    twin_bytes: what a page loads, before gzip. twin_made_s: all that is made at the start, without
    loading libraries.
    """

    triangles: int
    deform_precompute_s: float
    deform_frame_ms: float
    marker_error_mm: float
    least_weight: float
    greatest_weight: float
    twin_bytes: int
    twin_made_s: float


def twin_figures(face: FaceModel, seed: int = 0) -> TwinFigures:
    """All of them; takes a few seconds."""
    mean = load_mean_face()
    precompute_s = []
    for _ in range(3):
        surface = head_surface(mean)
        begun = time.perf_counter()
        skin = skin_morphs(face, surface)
        precompute_s.append(time.perf_counter() - begun)
    begun = time.perf_counter()
    packed = pack(make_twin(face, mean))
    twin_made_s = time.perf_counter() - begun
    random = np.random.default_rng(seed)
    coefficients = random.multivariate_normal(
        np.zeros(face.n_components), face.covariance, _FACES
    ).astype(np.float32)
    drawn = unpack(packed)["skin"]
    base = drawn["places_mm"].ravel()
    targets = np.stack([drawn["morphs"][f"c{k}"].ravel() for k in range(face.n_components)])
    frame_s, misses_mm = [], []
    markers = [face.layout.landmarks[i] for i in skin.points]
    mean_mm, basis = worn_face(face, surface.places_mm[markers], skin.points)
    wanted = mean_mm + np.tensordot(coefficients.astype(np.float64), basis, axes=1)
    for row, wanted_mm in zip(coefficients, wanted, strict=True):
        begun = time.perf_counter()
        mesh = base + row @ targets
        frame_s.append(time.perf_counter() - begun)
        misses_mm.append(np.linalg.norm(mesh.reshape(-1, 3)[markers] - wanted_mm, axis=1).max())
    return TwinFigures(
        triangles=len(surface.triangles),
        deform_precompute_s=min(precompute_s),
        deform_frame_ms=1000.0 * float(np.median(frame_s)),
        marker_error_mm=float(np.max(misses_mm)),
        least_weight=float(skin.weights.min()),
        greatest_weight=float(skin.weights.max()),
        twin_bytes=len(packed),
        twin_made_s=twin_made_s,
    )
