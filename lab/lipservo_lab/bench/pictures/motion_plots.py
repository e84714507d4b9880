"""Pictures of `lipservo bench motion`; needs matplotlib, the extra `plots`.

A sheet of mouths: one for each phoneme, as it looks in the middle of a short word.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from lipservo.terminal.pictures import save_picture, without_screen
from lipservo_lab.corpus.utterance import Utterance
from lipservo_lab.evaluation.motion.measures import CLOSING, lip_shapes_mm
from lipservo_lab.evaluation.motion.methods import (
    CATMULL_ROM,
    REFERENCE,
    Heard,
    LiveMethod,
    all_methods,
)
from lipservo_lab.evaluation.motion.minimal_pairs import AFTER
from lipservo_lab.learning.motion.trained_model import TrainedModel
from lipsync.arrays import Array
from lipsync.markers import CLOSED_GAP_MM, INNER_LIP_GROUP, OUTER_LIP_GROUP
from lipsync.motion.finishing import BILABIALS
from lipsync.motion.live_synthesizer import LIVE_STRATEGY, UNIT_STRATEGY
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
    """Draw the mouth of every phoneme as the live method moves it.

    The model's layout must have both lips.
    """
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
    """Return the face of a phoneme as the live method makes it.

    Consonants stand between two AH, vowels between two T, silence alone. The face is that in the
    middle of the phoneme or, if lips close for it, at the instant when they are nearest.

    Returns
    -------
    Array
        (n_components,).
    """
    neighbour = "T" if phoneme in _VOWELS else SILENCE if phoneme == SILENCE else "AH"
    phonemes = (SILENCE, SILENCE, neighbour, phoneme, neighbour, SILENCE)
    events = tuple(
        PhonemeEvent(name, _PHONE_S * k, _PHONE_S * (k + 1)) for k, name in enumerate(phonemes)
    )
    times_s = np.arange(0.0, _PHONE_S * len(phonemes), TICK_S)
    faces = LiveMethod().faces(model, Heard(events), times_s, _LOOKAHEAD_S)
    inside = np.flatnonzero((times_s >= events[3].start_s) & (times_s < (events[3].end_s or 0.0)))
    shown_tick = inside[len(inside) // 2]
    if phoneme in CLOSING:
        shown_tick = inside[np.argmin(model.lip_gaps_mm(model.markers_mm(faces[inside])))]
    return np.asarray(faces[shown_tick])


def _draw_mouth(axis: "Axes", model: TrainedModel, points_mm: Array) -> None:
    """Fill the outer and the inner lip's outline of one face, (n_markers, 3) mm."""
    for group, colour in ((OUTER_LIP_GROUP, _LIPS), (INNER_LIP_GROUP, _INSIDE)):
        points = list(model.layout.group(group))
        axis.fill(points_mm[points, 0], points_mm[points, 1], color=colour, linewidth=0)


Row = Mapping[str, object]

#: Look-ahead of the trajectories drawn.
_DRAWN_LOOKAHEAD_S = 0.1
_DRAWN_RATE_HZ = 100.0
#: One that opens the mouth, and one of the finer ones.
_DRAWN_COMPONENTS = (1, 6)
#: Shown before and after speech, s.
_MARGIN_S = 0.2
RECORDED = "recorded"
#: The same colour in every picture.
COLOURS = {
    RECORDED: "black",
    LIVE_STRATEGY: "tab:red",
    UNIT_STRATEGY: "firebrick",
    REFERENCE: "tab:orange",
    "cohen-massaro-tuned": "tab:olive",
    "plain-regression": "tab:blue",
    "priority": "tab:green",
    "naive": "tab:purple",
    "mean-face": "tab:gray",
    CATMULL_ROM: "tab:brown",
    "model-based": "darkcyan",
    "heard": "mediumvioletred",
}


#: What is drawn into the folder.
PICTURES = ("trajectory.png", "recovery.png", "mouths.png")


def draw(folder: Path, model: TrainedModel, unseen: Utterance, recovery: Sequence[Row]) -> None:
    """Draw `PICTURES` into a folder: mouths, a sentence's trajectory, recovery from an error.

    unseen: a sentence that the model has not learned. recovery: rows of `recovery_rows`.
    """
    without_screen()
    draw_mouths(folder / "mouths.png", model)
    draw_trajectory(folder, model, unseen)
    draw_recovery(folder, recovery)


def draw_trajectory(folder: Path, model: TrainedModel, utterance: Utterance) -> None:
    """Draw lip gap, lip width and two components of a sentence, recorded and synthesised."""
    from matplotlib import pyplot as plt

    recorded_s = np.arange(len(utterance.markers_mm)) / utterance.frame_rate_hz
    times_s = np.arange(0.0, recorded_s[-1], 1.0 / _DRAWN_RATE_HZ)
    curves = {}
    for name in (REFERENCE, "priority", LIVE_STRATEGY):
        method = all_methods()[name]
        faces = method.faces(model, Heard(utterance.phones), times_s, _DRAWN_LOOKAHEAD_S)
        curves[name] = times_s, motion_curves(model, faces)
    curves[RECORDED] = recorded_s, motion_curves(model, model.coefficients(utterance.markers_mm))
    figure, axes = plt.subplots(
        4, 1, sharex=True, figsize=(9, 9), layout="constrained", height_ratios=(2, 1, 1, 1)
    )
    first, fine = _DRAWN_COMPONENTS[0], min(_DRAWN_COMPONENTS[1], model.n_components)
    labels = ("inner lip gap, mm", "width, mm", f"component {first}, mm", f"component {fine}, mm")
    for axis, label, number in zip(axes, labels, range(4), strict=True):
        for name, (at_s, values) in curves.items():
            line_width = 2.0 if name in (RECORDED, LIVE_STRATEGY) else 0.9
            axis.plot(at_s, values[number], label=name, linewidth=line_width, color=COLOURS[name])
        axis.set_ylabel(label)
    mark_phones(axes[0], utterance)
    axes[0].legend(fontsize=8)
    axes[-1].set_xlabel("s")
    save_picture(figure, folder / "trajectory.png")
    plt.close(figure)


def mark_phones(
    axis: "Axes", utterance: Utterance, heights: Sequence[float] = (1.02, 1.07)
) -> None:
    """Write phone names above an axis, draw their beginnings as lines, shade closures of P B M.

    heights: names stand at these in turn, so that those of short phones do not overlap.
    """
    named_phones = [p for p in utterance.phones if p.phoneme != SILENCE] or list(utterance.phones)
    for number, phone in enumerate(named_phones):
        height = heights[number % len(heights)]
        transform = axis.get_xaxis_transform()
        axis.text(phone.start_s, height, phone.phoneme, fontsize=8, transform=transform)
        axis.axvline(phone.start_s, color="0.85", linewidth=0.6, zorder=0)
        if phone.phoneme in BILABIALS:
            axis.axvspan(phone.start_s, phone.end_s or phone.start_s, color="0.9", zorder=0)
    axis.axhline(CLOSED_GAP_MM, color="0.5", linewidth=0.6, linestyle=":")
    last_s = named_phones[-1].end_s or named_phones[-1].start_s
    axis.set_xlim(named_phones[0].start_s - _MARGIN_S, last_s + _MARGIN_S)


def draw_recovery(folder: Path, rows: Sequence[Row]) -> None:
    """Draw how much of one phoneme's deviation is left in the phonemes after it.

    Recorded motion, and the live method with a wrong phoneme, corrected or not.
    """
    from matplotlib import pyplot as plt

    drawn_ms = round(_DRAWN_LOOKAHEAD_S * 1e3)
    styles = {"another true phoneme": "-", "never corrected": "--", "corrected after 95 ms": ":"}
    figure, axis = plt.subplots(figsize=(7, 4.5), layout="constrained")
    for row in rows:
        name, case = str(row["strategy"]), str(row["case"])
        is_ours = name == LIVE_STRATEGY and row["lookahead_ms"] == drawn_ms
        if not isinstance(row["left"], list) or not (is_ours or name == RECORDED):
            continue
        shares_left = np.array([float_or_nan(share) for share in row["left"]])
        label = f"{name}, {case}"
        axis.plot(shares_left, linestyle=styles[case], marker="o", label=label, color=COLOURS[name])
        if name == RECORDED:
            low, high = np.array(row["left_95"], dtype=np.float64).T
            axis.fill_between(range(len(shares_left)), low, high, color="0.9", zorder=0)
    axis.set_xticks(range(1 + AFTER), ["the phoneme", *(f"+{k}" for k in range(1, 1 + AFTER))])
    axis.set_ylabel("share of its deviation that is left")
    if axis.lines:
        axis.legend(fontsize=8)
    save_picture(figure, folder / "recovery.png")
    plt.close(figure)


def motion_curves(model: TrainedModel, faces: Array) -> tuple[Array, ...]:
    """Return lip gap and width, the first component, and one of the finer ones.

    Parameters
    ----------
    model : TrainedModel
        The face.
    faces : Array
        (n, n_components).

    Returns
    -------
    tuple[Array, ...]
        (n,) each, the first two in mm.
    """
    gap_mm, width_mm, _ = lip_shapes_mm(model, model.markers_mm(faces)).T
    first, fine = (min(number, model.n_components) - 1 for number in _DRAWN_COMPONENTS)
    return gap_mm, width_mm, faces[:, first], faces[:, fine]


def float_or_nan(value: object) -> float:
    """Return a number of a row as float; NaN for what a row leaves out."""
    return float(value) if isinstance(value, int | float) else float("nan")
