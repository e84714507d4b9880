"""Pictures of `lipservo bench motion --offline`; needs matplotlib, the extra `plots`."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from lipservo.terminal.pictures import save_picture, without_screen
from lipservo_lab.bench.pictures.motion_plots import (
    COLOURS,
    RECORDED,
    float_or_nan,
    mark_phones,
    motion_curves,
)
from lipservo_lab.corpus.utterance import Utterance, speech_frames
from lipservo_lab.evaluation.motion.methods import CATMULL_ROM, REFERENCE, Heard, Method
from lipservo_lab.learning.motion.trained_model import TrainedModel
from lipservo_lab.learning.offline.state_training import joint_parameters, speech_manifold
from lipsync.arrays import Array, Indices
from lipsync.audio.file import read_speech
from lipsync.motion.live_synthesizer import LIVE_STRATEGY
from lipsync.offline.line_methods import PLANNED_METHODS
from lipsync.offline.line_synthesis import joined_phones, model_line
from lipsync.offline.offline_model import StateModel, at_times, cepstra

Row = Mapping[str, object]

#: What is drawn into the folder.
LINE_PICTURES = ("line-trajectory.png", "line-states.png", "line-errors.png")
_DRAWN_RATE_HZ = 100.0
#: So many sentences of the training are laid out; more hide each other.
_LAID_OUT = 40
#: Fewer landmarks than states are found with: a picture needs few dimensions.
_LANDMARKS = 200
#: How far a mouth is from the mean one, and what tells opening from closing; the second is the
#: size of both once more.
_DIMENSIONS = (0, 2)
_MARGIN = 0.2
_COMPARED = (REFERENCE, CATMULL_ROM, *PLANNED_METHODS, LIVE_STRATEGY)
#: Of `motion_curves`, those that are drawn.
_CURVES = ("inner lip gap, mm", "width, mm", "component 1, mm")
_FIGURES = {
    "ratio": "RMSE over that of the fixed reference",
    "gap_r": "correlation of the lip gap",
    "closure_hits": "P B M with closed lips",
}


def draw_lines(
    folder: Path,
    model: TrainedModel,
    states: StateModel,
    training: Sequence[Utterance],
    unseen: Utterance,
    methods: Sequence[Method],
    rows: Sequence[Row],
) -> None:
    """Draw `LINE_PICTURES` into a folder: a sentence by each method, its path of states, errors.

    states: the offline model of the sentences `training`, in their order. unseen: the sentence
    drawn. methods: only those that use a line whole are drawn. rows: of `bench motion`.
    """
    without_screen()
    drawn = [m for m in methods if m.name in (CATMULL_ROM, *PLANNED_METHODS)]
    draw_trajectories(folder / LINE_PICTURES[0], model, unseen, drawn)
    draw_states(folder / LINE_PICTURES[1], states, training, unseen)
    draw_figures(folder / LINE_PICTURES[2], rows)


def draw_trajectories(
    path: Path, model: TrainedModel, utterance: Utterance, methods: Sequence[Method]
) -> None:
    """Draw lip gap, lip width and first component of a sentence: recorded (black) and by methods.

    Width and component are shifted to the recording's mean over speech. A column for each method.
    """
    from matplotlib import pyplot as plt

    frames_s = np.arange(len(utterance.markers_mm)) / utterance.frame_rate_hz
    times_s = np.arange(0.0, frames_s[-1], 1.0 / _DRAWN_RATE_HZ)
    heard = Heard(utterance.phones, sound_path=utterance.sound_path)
    in_speech = speech_frames(utterance)
    recorded = motion_curves(model, model.coefficients(utterance.markers_mm))
    figure, axes = plt.subplots(
        len(_CURVES), len(methods), sharex=True, sharey="row", squeeze=False,
        figsize=(3.4 * len(methods), 5.6), layout="constrained",
    )  # fmt: skip
    for column, method in zip(axes.T, methods, strict=True):
        made = motion_curves(model, method.faces(model, heard, times_s, 0.0))
        for number, (axis, seen, is_now) in enumerate(zip(column, recorded, made, strict=False)):
            # A sentence is wider or narrower as a whole, which no phoneme tells.
            off = np.interp(frames_s, times_s, is_now)[in_speech].mean() - seen[in_speech].mean()
            shift = 0.0 if number == 0 else off
            axis.plot(frames_s, seen, color=COLOURS[RECORDED], linewidth=1.4)
            axis.plot(times_s, is_now - shift, color=COLOURS[method.name], linewidth=1.6)
        mark_phones(column[0], utterance, heights=(1.03, 1.12, 1.21))
        title = f"{method.name}; black: recorded"
        column[0].set_title(title, color=COLOURS[method.name], fontsize=10, pad=36)
        column[-1].set_xlabel("s")
    for axis, label in zip(axes[:, 0], _CURVES, strict=True):
        axis.set_ylabel(label)
    save_picture(figure, path)
    plt.close(figure)


def draw_states(
    path: Path, model: StateModel, training: Sequence[Utterance], unseen: Utterance
) -> None:
    """Draw the speech manifold in two of its dimensions.

    Left: recorded frames, coloured by their states. Right: the path of the sentence `unseen`, as
    recorded, and by the centres of the states that the model chooses for it.
    """
    from matplotlib import pyplot as plt

    places, states, recorded = laid_out(model, training, unseen)
    centre_of = {int(s): places[states == s].mean(axis=0) for s in np.unique(states)}
    in_speech = speech_frames(unseen)
    way = np.array(
        [centre_of[s] for s, spoken in zip(_chosen_states(model, unseen), in_speech, strict=True)
         if spoken and s in centre_of]
    )  # fmt: skip
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 4.2), layout="constrained")
    # Numbers of states that were one cluster are near: dealt anew, they get other colours.
    colours = np.random.default_rng(0).permutation(model.n_states)
    left.scatter(*places.T, c=colours[states], cmap="hsv", s=3, linewidths=0)
    left.set_title(f"{len(places)} recorded frames in {model.n_states} states", fontsize=10)
    right.scatter(*places.T, color="0.88", s=4, linewidths=0)
    frames = np.flatnonzero(in_speech)
    between = np.linspace(frames[0], frames[-1], 10 * len(frames))
    smooth = CubicSpline(np.arange(len(recorded)), recorded)(between)
    right.plot(*smooth.T, color=COLOURS[RECORDED], linewidth=1.2, label=RECORDED)
    right.plot(*way.T, color=COLOURS["model-based"], linewidth=0.5, alpha=0.5)
    right.scatter(*way.T, color=COLOURS["model-based"], s=16, zorder=3, label="states chosen")
    right.set_title(f"a sentence that was not learned, {unseen.name}", fontsize=10)
    drawn = np.concatenate([recorded[in_speech], way])
    (low_x, low_y), (high_x, high_y) = drawn.min(axis=0), drawn.max(axis=0)
    right.set_xlim(low_x - _MARGIN, high_x + _MARGIN)
    right.set_ylim(low_y - _MARGIN, high_y + _MARGIN)
    right.legend(fontsize=8)
    for axis in (left, right):
        axis.set_xlabel(f"speech manifold, dimension {_DIMENSIONS[0] + 1}")
        axis.set_ylabel(f"dimension {_DIMENSIONS[1] + 1}")
    save_picture(figure, path)
    plt.close(figure)


def laid_out(
    model: StateModel, training: Sequence[Utterance], unseen: Utterance
) -> tuple[Array, Indices, Array]:
    """Compute manifold places of frames anew: a model keeps the state of each frame, not its place.

    Parameters
    ----------
    model : StateModel
        An offline model.
    training : Sequence[Utterance]
        The sentences that it was trained on, in their order.
    unseen : Utterance
        Another sentence.

    Returns
    -------
    tuple[Array, Indices, Array]
        Manifold places (n, 2) and states (n,) of some training sentences, and places of the other,
        (m, 2).
    """
    step = -(-len(training) // _LAID_OUT)
    components, states = [], []
    for number in range(0, len(training), step):
        components.append(_components(model, training[number]))
        states.append(model.states[model.borders[number] : model.borders[number + 1]])
    components.append(_components(model, unseen))
    places = speech_manifold(joint_parameters(components), _LANDMARKS)
    places = places[:, [min(d, places.shape[1] - 1) for d in _DIMENSIONS]]
    n_learned = len(places) - len(components[-1])
    return places[:n_learned], np.concatenate(states), places[n_learned:]


def _components(model: StateModel, utterance: Utterance) -> Array:
    """Return a sentence's frames as components of the model's basis, (n_frames, n_components)."""
    flat = utterance.markers_mm.reshape(len(utterance.markers_mm), -1)
    return np.asarray((flat - model.mean_mm) @ model.basis.T)


def _chosen_states(model: StateModel, utterance: Utterance) -> list[int]:
    """Return the states that the model chooses for a sentence, one for each frame."""
    n_frames = len(utterance.markers_mm)
    times_s = np.arange(n_frames) / model.frame_rate_hz
    heard = at_times(cepstra(read_speech(utterance.sound_path)), times_s)
    phones = joined_phones(utterance.phones, n_frames / model.frame_rate_hz)
    return [int(state) for state in model_line(model, heard, phones).path.states]


def draw_figures(path: Path, rows: Sequence[Row]) -> None:
    """Draw ratio, gap correlation and closures as bars with intervals, a group for each split.

    A live method is drawn at its longest look-ahead.
    """
    from matplotlib import pyplot as plt

    names = [name for name in _COMPARED if any(row["strategy"] == name for row in rows)]
    splits = list(dict.fromkeys(str(row["split"]) for row in rows))
    longest_ms = max(int(str(row["lookahead_ms"])) for row in rows)
    row_of = {
        (row["strategy"], row["split"]): row for row in rows if row["lookahead_ms"] == longest_ms
    }
    figure, axes = plt.subplots(1, len(_FIGURES), figsize=(12, 4), layout="constrained")
    width = 0.8 / len(names)
    for axis, (key, label) in zip(axes, _FIGURES.items(), strict=True):
        for number, name in enumerate(names):
            mine = [row_of[name, split] for split in splits]
            values = np.array([float_or_nan(row[key]) for row in mine])
            ends = np.array([row[f"{key}_95"] or (np.nan, np.nan) for row in mine], np.float64)
            axis.bar(
                np.arange(len(splits)) + number * width, values, width,
                yerr=np.abs(ends.T - values), capsize=2, color=COLOURS[name], label=name,
            )  # fmt: skip
        axis.set_xticks(np.arange(len(splits)) + 0.4 - width / 2, splits)
        axis.set_ylabel(label)
    figure.legend(
        *axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(names)
    )
    save_picture(figure, path)
    plt.close(figure)
