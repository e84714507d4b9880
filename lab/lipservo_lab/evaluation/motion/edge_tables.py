"""What Edge, Hilton and Jackson print of their recordings and modes of lip shape, and ours.

Their modes (principal components) are of 20,000 points recorded by stereo cameras, of which 100
were computed; ours are of the face's points. Shares are of the variance of so many modes.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from sklearn.decomposition import PCA

from lipservo_lab.corpus.utterance import Utterance
from lipservo_lab.evaluation.motion.measures import LIP_SHAPE, lip_shapes_mm
from lipsync.arrays import Array
from lipsync.face.model import FaceModel

Row = dict[str, object]
#: Share of frames at either end of the lip gap whose means are the closed and the open jaw; the
#: paper's jaw layer is a blend of the two.
OUTERMOST: Final = 0.01
#: Number of modes that the paper computed, and the share of their variance in the first N_PRINTED.
N_MODES, N_PRINTED, PRINTED_SHARE = 100, 10, 0.95
#: Numbers of modes that have a row.
SHOWN: Final = (*range(1, 11), 15, 20, 30, 50, 70, N_MODES)
#: The paper's recordings.
PRINTED_RECORDINGS: Final = {
    "sentences": 103, "minutes": 8.0, "frames_per_s": 60.0, "points": 20_000
}  # fmt: skip
#: The paper's names of its first two modes, and the measure of our lips that corresponds.
PRINTED_MEANING: Final = {1: ("jaw opening", "gap"), 2: ("rounding, protrusion", "width")}


def edge_tables(face: FaceModel, learned: Sequence[Utterance]) -> dict[str, list[Row]]:
    """Return rows of edge_recordings, edge_modes, edge_meaning and edge_jaw: the paper's and ours.

    learned: the sentences that the face was learned from, all at one frame rate. edge_meaning: how
    each of the face's first two components correlates with the gap, width and protrusion of the
    lips. edge_jaw: how far points of the jaw and chin are from the recorded ones, placed by the
    paper's jaw layer and by our components; empty for a layout without these points.
    """
    frames_mm = np.concatenate([u.markers_mm for u in learned]).astype(np.float64)
    ours = {
        "sentences": len(learned),
        "minutes": sum(len(u.markers_mm) / u.frame_rate_hz for u in learned) / 60.0,
        "frames_per_s": learned[0].frame_rate_hz,
        "points": frames_mm.shape[1],
    }
    held = shares_held(frames_mm.reshape(len(frames_mm), -1))
    shapes, modes = lip_shapes_mm(face, frames_mm), face.coefficients(frames_mm)
    return {
        "edge_recordings": [
            {"figure": name, "printed": printed, "ours": ours[name]}
            for name, printed in PRINTED_RECORDINGS.items()
        ],
        "edge_modes": [
            {"modes": n, "printed": PRINTED_SHARE if n == N_PRINTED else None, "ours": share}
            for n, share in enumerate(held.tolist(), 1)
            if n in SHOWN
        ],
        "edge_meaning": [
            {"mode": n, "printed": printed, "seen_in": measure}
            | {
                name: float(np.corrcoef(modes[:, n - 1], shape)[0, 1])
                for name, shape in zip(LIP_SHAPE, shapes.T, strict=True)
            }
            for n, (printed, measure) in PRINTED_MEANING.items()
            if n <= face.n_components
        ],
        "edge_jaw": _jaw_rows(face, frames_mm, shapes[:, 0]),
    }


def _jaw_rows(face: FaceModel, frames_mm: Array, gaps_mm: Array) -> list[Row]:
    """Return how well the paper's blend and our components place points of jaw and chin.

    frames_mm: (n, n_points, 3), recorded; gaps_mm: (n,), their lip gaps, whose extremes define
    closed and open. `rms_mm` is the distance over points and frames. Empty for a face without these
    points.
    """
    points = [*face.layout.group("jaw"), *face.layout.group("chin")]
    if not points:
        return []
    jaw_mm = frames_mm[:, points].reshape(len(frames_mm), -1)
    ours_mm = face.markers_mm(face.coefficients(frames_mm))[:, points].reshape(jaw_mm.shape)
    narrow_mm, wide_mm = np.quantile(gaps_mm, (OUTERMOST, 1.0 - OUTERMOST))
    closed, opened = jaw_mm[gaps_mm <= narrow_mm].mean(0), jaw_mm[gaps_mm >= wide_mm].mean(0)
    opening = opened - closed
    # Each frame's best blend of closed and open: its projection on the line between them.
    blend_mm = closed + np.outer((jaw_mm - closed) @ opening / (opening @ opening), opening)
    return [
        {"placed_by": name, "rms_mm": float(np.sqrt(((placed - jaw_mm) ** 2).mean() * 3.0))}
        for name, placed in (("blend, eq. (5)", blend_mm), ("components", ours_mm))
    ]


def shares_held(frames: Array) -> Array:
    """Return the shares of variance of the first 1, 2, ... modes, of that of `N_MODES` modes.

    Parameters
    ----------
    frames : Array
        (n_frames, n_values).

    Returns
    -------
    Array
        (N_MODES,), ascending to 1; fewer where frames have fewer values.
    """
    modes = PCA(min(N_MODES, *frames.shape)).fit(frames)
    held = np.cumsum(modes.explained_variance_)
    return np.asarray(held / held[-1])
