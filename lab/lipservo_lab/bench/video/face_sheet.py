"""The picture sheet of an import: every clip's face with its points, and what became of it."""

import math
import textwrap
from collections.abc import Sequence
from pathlib import Path

from lipservo.terminal.pictures import save_picture, without_screen
from lipservo_lab.video.clip_report import ClipReport
from lipservo_lab.video.face_track import FaceSample
from lipsync.face_mesh import INNER_LIP, OUTER_LIP

#: More faces than this nobody looks at; of more, so many are drawn, evenly chosen.
_MOST, _COLUMNS = 120, 8
_INCHES = 1.5


def draw_sheet(samples: Sequence[tuple[FaceSample, ClipReport]], picture: Path) -> None:
    """Points in green, lips in red; a red title for what was left out. Raises OutputError."""
    without_screen()
    from matplotlib import pyplot as plt

    # What was left out is what one looks for.
    chosen = sorted(samples[:: math.ceil(len(samples) / _MOST) or 1], key=_is_used)
    n_rows = max(1, math.ceil(len(chosen) / _COLUMNS))
    figure, axes = plt.subplots(
        n_rows, _COLUMNS, figsize=(_COLUMNS * _INCHES, n_rows * _INCHES * 1.3), squeeze=False
    )
    for place in axes.flat:
        place.axis("off")
    for place, (sample, report) in zip(axes.flat, chosen, strict=False):
        place.imshow(sample.picture)
        place.plot(*sample.points.T, ",", color="#40ff60")
        for ring in (OUTER_LIP, INNER_LIP):
            place.plot(*sample.points[[*ring, ring[0]]].T, color="#ff3030", linewidth=0.7)
        place.set_xlim(0, sample.picture.shape[1])
        place.set_ylim(sample.picture.shape[0], 0)
        place.set_title(_title(report), fontsize=6, color="red" if report.left_out else "black")
    figure.tight_layout()
    save_picture(figure, picture)
    plt.close(figure)


def _is_used(sample: tuple[FaceSample, ClipReport]) -> bool:
    return sample[1].left_out is None


def _title(report: ClipReport) -> str:
    if report.left_out is not None:
        return "\n".join(textwrap.wrap(f"{report.clip}: {report.left_out}", 28)[:3])
    return f"{report.clip}\n{report.shift_ms:+d} ms, r {report.gap_r:.2f}"
