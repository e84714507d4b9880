"""Pictures of `lipservo bench motion`; needs matplotlib, the extra `plots`."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lipsync.animpho.closures import lip_gaps_mm
from lipsync.animpho.live import LIVE_STRATEGY
from lipsync.animpho.model import FaceModel
from lipsync.corpus.utterance import Utterance
from lipsync.errors import UserError
from lipsync.evaluation.methods import REFERENCE, Heard, all_methods
from lipsync.evaluation.wrong_phonemes import ErrorRow, error_rows

Array = NDArray[np.float64]
Row = Mapping[str, object]

#: Look-ahead of the trajectories drawn.
_DRAWN_LOOKAHEAD_S = 0.1
_WITH_ERRORS = ("naive", "priority", LIVE_STRATEGY)
_SENTENCES_WITH_ERRORS = 30


class PlotError(UserError):
    """Pictures that cannot be drawn."""


def check_plots(folder: Path) -> None:
    """Make the folder, and see that there is something to draw with, before hours of measuring."""
    try:
        import matplotlib as mpl
    except ImportError:
        raise PlotError("pictures need matplotlib: pip install 'lipservo[plots]'") from None
    mpl.use("Agg")
    if folder.exists() and not folder.is_dir():
        raise PlotError(f"{folder}: is a file; --plots wants a folder")
    folder.mkdir(parents=True, exist_ok=True)


def draw(
    folder: Path, model: FaceModel, utterances: Sequence[Utterance], rows: Sequence[Row]
) -> list[dict[str, object]]:
    """All three pictures: trajectory, error against look-ahead, error against wrong phonemes.

    utterances: not the model's. Returns what the last picture shows.
    """
    draw_trajectory(folder, model, utterances[0])
    draw_lookahead(folder, rows)
    methods = [m for name, m in all_methods().items() if name in _WITH_ERRORS]
    few = utterances[:_SENTENCES_WITH_ERRORS]
    errors = error_rows(model, few, methods, lookahead_s=_DRAWN_LOOKAHEAD_S)
    draw_errors(folder, errors)
    return [asdict(row) for row in errors]


def draw_trajectory(folder: Path, model: FaceModel, utterance: Utterance) -> None:
    """The first two components and the lip gap of one sentence, recorded and synthesised."""
    from matplotlib import pyplot as plt

    times_s = np.arange(len(utterance.markers_mm)) / utterance.frame_rate_hz
    curves = {"recorded": _curves(model, model.coefficients(utterance.markers_mm))}
    for name in (REFERENCE, "priority", LIVE_STRATEGY):
        method = all_methods()[name]
        faces = method.faces(model, Heard(utterance.phones), times_s, _DRAWN_LOOKAHEAD_S)
        curves[name] = _curves(model, faces)
    figure, axes = plt.subplots(3, 1, sharex=True, figsize=(9, 7), layout="constrained")
    labels = ("component 1, mm", "component 2, mm", "inner lip gap, mm")
    for axis, label, number in zip(axes, labels, range(3), strict=True):
        for name, values in curves.items():
            thick = 2.0 if name in ("recorded", LIVE_STRATEGY) else 0.8
            axis.plot(times_s, values[number], label=name, linewidth=thick)
        axis.set_ylabel(label)
    for number, phone in enumerate(utterance.phones):
        # Above the curves, on two lines in turn, so that short phones do not overlap.
        height = 1.02 + 0.09 * (number % 2)
        place = axes[0].get_xaxis_transform()
        axes[0].text(phone.start_s, height, phone.phoneme, fontsize=7, transform=place)
    axes[0].legend(ncols=4, fontsize=8)
    axes[2].set_xlabel("s")
    figure.savefig(folder / "trajectory.png", dpi=110)
    plt.close(figure)


def draw_lookahead(folder: Path, rows: Sequence[Row]) -> None:
    """Ratio to the fixed reference against look-ahead, a line for each method and split."""
    from matplotlib import pyplot as plt

    figure, axis = plt.subplots(figsize=(7, 5), layout="constrained")
    for key in dict.fromkeys((r["strategy"], r["split"]) for r in rows):
        if key[0] not in (REFERENCE, "cohen-massaro-tuned", "plain-regression", LIVE_STRATEGY):
            continue
        mine = [r for r in rows if (r["strategy"], r["split"]) == key]
        axis.plot(
            [float(str(r["lookahead_ms"])) for r in mine],
            [float(str(r["ratio"])) for r in mine],
            marker="o",
            label=f"{key[0]}, {key[1]}",
        )
    axis.set_xlabel("look-ahead, ms")
    axis.set_ylabel("RMSE over that of the fixed reference")
    axis.legend(fontsize=8)
    figure.savefig(folder / "lookahead.png", dpi=110)
    plt.close(figure)


def draw_errors(folder: Path, rows: Sequence[ErrorRow]) -> None:
    """RMSE against the share of phonemes that are wrong, a panel for each kind of error."""
    from matplotlib import pyplot as plt

    kinds = list(dict.fromkeys(row.kind for row in rows))
    figure, axes = plt.subplots(
        1, len(kinds), sharey=True, squeeze=False, figsize=(10, 4), layout="constrained"
    )
    for axis, kind in zip(axes[0], kinds, strict=True):
        for name in dict.fromkeys(row.strategy for row in rows):
            mine = [row for row in rows if row.kind == kind and row.strategy == name]
            axis.plot([r.rate for r in mine], [r.rmse_mm for r in mine], marker="o", label=name)
        axis.set_title(kind)
        axis.set_xlabel("share of wrong phonemes")
    axes[0][0].set_ylabel("RMSE, mm")
    axes[0][0].legend(fontsize=8)
    figure.savefig(folder / "errors.png", dpi=110)
    plt.close(figure)


def _curves(model: FaceModel, faces: Array) -> tuple[Array, Array, Array]:
    return faces[:, 0], faces[:, 1], lip_gaps_mm(model.markers_mm(faces))
