"""A sheet of mouths: one for each phoneme, as it looks in the middle of a short word."""

from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from lipservo.terminal.pictures import save_picture, without_screen
from lipservo_lab.evaluation.motion.measures import CLOSING
from lipservo_lab.evaluation.motion.methods import Heard, LiveMethod
from lipservo_lab.learning.motion.trained_model import TrainedModel
from lipsync.arrays import Array
from lipsync.markers import INNER_LIP_GROUP, OUTER_LIP_GROUP
from lipsync.motion.tick_plan import TICK_S
from lipsync.phonemes import PHONEMES, SILENCE, PhonemeEvent

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLUMNS = 8
_PHONE_S = 0.12
_LOOKAHEAD_S = 0.1
#: Between two T, which leave a vowel its own shape.
_VOWELS: Final = frozenset(
    ("AA", "AE", "AH", "AO", "AW", "AY", "EH", "ER", "EY", "IH", "IY", "OW", "OY", "UH", "UW")
)
_LIPS, _INSIDE = "#c4696b", "#3a1418"


def draw_mouths(path: Path, model: TrainedModel) -> None:
    """Draw all phonemes, in the live method's motion; the model's layout has both lips."""
    without_screen()
    from matplotlib import pyplot as plt

    n_rows = -(-len(PHONEMES) // _COLUMNS)
    figure, axes = plt.subplots(
        n_rows, _COLUMNS, figsize=(1.5 * _COLUMNS, 1.35 * n_rows), layout="constrained"
    )
    markers_mm = [model.markers_mm(phoneme_face(model, p)[None])[0] for p in PHONEMES]
    lips_mm = np.array([m[list(model.layout.lips), :2] for m in markers_mm])
    low, high = lips_mm.min(axis=(0, 1)) - 4.0, lips_mm.max(axis=(0, 1)) + 4.0
    for axis in axes.flat:
        axis.set_axis_off()
        axis.set_aspect("equal")
        axis.set_xlim(low[0], high[0])
        axis.set_ylim(low[1], high[1])
    for axis, phoneme, points_mm in zip(axes.flat, PHONEMES, markers_mm, strict=False):
        _draw_mouth(axis, model, points_mm)
        axis.set_title(phoneme, fontsize=9, pad=1)
    save_picture(figure, path)
    plt.close(figure)


def phoneme_face(model: TrainedModel, phoneme: str) -> Array:
    """(n_components,): a consonant between two AH, a vowel between two T, silence alone.

    In the middle of the phoneme; of those for which lips close, at the instant when they are
    nearest.
    """
    neighbour = "T" if phoneme in _VOWELS else SILENCE if phoneme == SILENCE else "AH"
    said = (SILENCE, SILENCE, neighbour, phoneme, neighbour, SILENCE)
    events = tuple(
        PhonemeEvent(name, _PHONE_S * k, _PHONE_S * (k + 1)) for k, name in enumerate(said)
    )
    times_s = np.arange(0.0, _PHONE_S * len(said), TICK_S)
    faces = LiveMethod().faces(model, Heard(events), times_s, _LOOKAHEAD_S)
    inside = np.flatnonzero((times_s >= events[3].start_s) & (times_s < (events[3].end_s or 0.0)))
    shown = inside[len(inside) // 2]
    if phoneme in CLOSING:
        shown = inside[np.argmin(model.lip_gaps_mm(model.markers_mm(faces[inside])))]
    return np.asarray(faces[shown])


def _draw_mouth(axis: "Axes", model: TrainedModel, points_mm: Array) -> None:
    for group, colour in ((OUTER_LIP_GROUP, _LIPS), (INNER_LIP_GROUP, _INSIDE)):
        points = list(model.layout.group(group))
        axis.fill(points_mm[points, 0], points_mm[points, 1], color=colour, linewidth=0)
