"""A picture of which mouths a robot can make: openings and widths of speech, and what is missing.

Needs matplotlib, the extra `plots`.
"""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from calibration.calibration import Calibration, CalibrationError
from calibration.fit.measured import MeasuredFit
from calibration.fit.measured_errors import REACHABLE_MM, ShapeErrors
from lipservo.terminal.pictures import save_picture, without_screen
from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.arrays import Array
from lipsync.phonemes import VISEME_CLASSES

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PICTURE = "coverage.png"
_FRAMES = 1500
#: Farther off than this all points look alike.
_WORST_MM = 1.5


def draw_coverage(
    folder: Path, model: FaceWithAnimPhos, calibration: Calibration, fit: MeasuredFit | None
) -> Path:
    """`coverage.png`: left every frame of speech by opening and width, right by viseme class.

    Raises CalibrationError for a calibration that measured nothing.
    """
    if fit is None:
        raise CalibrationError(
            "--plots needs lips that were measured; this calibration knows no millimetres"
        )
    without_screen()
    from matplotlib import pyplot as plt

    frames = model.animphos.frames
    frames = frames[:: max(1, len(frames) // _FRAMES)]
    opening_mm, width_mm, off_mm = _best_off(model, fit, frames)
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.6), width_ratios=(3, 2))
    points = left.scatter(
        width_mm, opening_mm, c=np.minimum(off_mm, _WORST_MM), s=9, cmap="viridis_r", vmin=0.0,
        vmax=_WORST_MM,
    )  # fmt: skip
    missed = off_mm > REACHABLE_MM
    left.scatter(
        width_mm[missed],
        opening_mm[missed],
        s=42,
        facecolors="none",
        edgecolors="red",
        linewidths=0.7,
    )
    left.set_xlabel("width asked for, mm")
    left.set_ylabel("opening asked for, mm (below 0: pressed)")
    left.set_title(f"{1 - missed.mean():.0%} of speech within {REACHABLE_MM} mm; red circles: not")
    figure.colorbar(points, ax=left, label="best pose off in opening or width, mm")
    _draw_classes(right, calibration)
    figure.suptitle(f"What this robot can make of speech, {calibration.origin.poses} poses")
    figure.tight_layout()
    path = folder / PICTURE
    save_picture(figure, path)
    plt.close(figure)
    return path


def draw_reach(folder: Path, calibration: Calibration) -> Path:
    """`coverage.png` from a calibration file alone: the viseme classes.

    Raises CalibrationError for a calibration that measured none.
    """
    if not calibration.coverage:
        raise CalibrationError(
            f"--plots needs a measured calibration; this one is {calibration.origin.method}"
        )
    without_screen()
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(5.5, 4.6))
    _draw_classes(axes, calibration)
    figure.tight_layout()
    path = folder / PICTURE
    save_picture(figure, path)
    plt.close(figure)
    return path


def _draw_classes(axes: "Axes", calibration: Calibration) -> None:
    """A bar for each viseme class: the part of its shapes within reach."""
    classes = [viseme for viseme in VISEME_CLASSES if viseme[0] in calibration.coverage]
    reach = [calibration.coverage[viseme[0]] for viseme in classes]
    rows = np.arange(len(classes))
    axes.barh(rows, [each.reachable for each in reach], color="tab:blue", height=0.6)
    for row, each in enumerate(reach):
        axes.text(1.01, row, f"{each.off_mm:.2f} mm", va="center", fontsize=8)
    axes.set_yticks(rows, [" ".join(viseme) for viseme in classes], fontsize=8)
    axes.invert_yaxis()
    axes.set_xlim(0.0, 1.0)
    axes.set_xlabel("part within reach; beside it, how far off this map is")


def _best_off(
    model: FaceWithAnimPhos, fit: MeasuredFit, frames: Array
) -> tuple[Array, Array, Array]:
    """Opening and width that are asked for, and how far the best pose is off; (n,) each, mm."""
    found = ShapeErrors(model, fit.retargeting.mouth, fit.retargeting)
    asked_mm, best_mm = found.openings_and_widths_mm(frames - model.rest)
    off_mm = np.abs(best_mm - asked_mm).max(axis=1)
    return asked_mm[:, 0] - fit.retargeting.closed_mm[0], asked_mm[:, 1], off_mm
