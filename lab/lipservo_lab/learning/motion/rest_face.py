"""The closed mouth of silence: what a face rests in, and what others' motion is laid on."""

from collections.abc import Iterable, Sequence

import numpy as np

from lipservo_lab.corpus.utterance import Utterance
from lipsync.arrays import Array
from lipsync.markers import CLOSED_GAP_MM, PointLayout
from lipsync.phonemes import SILENCE

#: In silence the speaker of grid_s1 has the lips within 1 mm in a third of the frames.
_CLOSED_SHARE = 1.0 / 3.0


def mean_at_rest(
    utterances: Iterable[Utterance], motion: Sequence[Array], layout: PointLayout
) -> Array:
    """The mean of all silent frames with closed lips; of the most closed tenth if none touch.

    motion: of each utterance (n_frames, n), whatever is to be averaged. Without silence, of all
    frames.
    """
    still, gap_mm = _silent_frames(utterances, motion, layout)
    if not len(still):
        still, gap_mm = np.concatenate(motion), np.zeros(sum(map(len, motion)))
    threshold = max(CLOSED_GAP_MM, float(np.quantile(gap_mm, 0.1)))
    return np.asarray(still[gap_mm <= threshold].mean(axis=0))


def closed_mouth_mm(utterances: Sequence[Utterance], layout: PointLayout) -> Array:
    """(n_points, 3): the mean of the most closed third of all silent frames.

    No distance in mm decides, so that it is the same mouth on a face of another size. Without
    silence, of all frames.
    """
    motion = [u.markers_mm.reshape(len(u.markers_mm), -1).astype(np.float64) for u in utterances]
    still, gap_mm = _silent_frames(utterances, motion, layout)
    if not len(still):
        still = np.concatenate(motion)
        gap_mm = np.linalg.norm(layout.gap_vectors_mm(still.reshape(len(still), -1, 3)), axis=1)
    closed: Array = still[gap_mm <= np.quantile(gap_mm, _CLOSED_SHARE)]
    return np.asarray(closed.mean(axis=0).reshape(-1, 3))


def _silent_frames(
    utterances: Iterable[Utterance], motion: Sequence[Array], layout: PointLayout
) -> tuple[Array, Array]:
    """What is to be averaged of frames outside all phones, (n, ...), and their lip gaps (n,)."""
    silent, gaps_mm = [], []
    for utterance, frames in zip(utterances, motion, strict=True):
        times_s = np.arange(len(frames)) / utterance.frame_rate_hz
        spoken = np.zeros(len(frames), dtype=bool)
        for phone in utterance.phones:
            if phone.phoneme != SILENCE and phone.end_s is not None:
                spoken |= (times_s >= phone.start_s) & (times_s < phone.end_s)
        lips = layout.gap_vectors_mm(utterance.markers_mm)
        silent.append(frames[~spoken])
        gaps_mm.append(np.linalg.norm(lips[~spoken], axis=1))
    return np.concatenate(silent), np.concatenate(gaps_mm)
