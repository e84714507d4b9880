"""The picture sheet of an import: every clip's face with its points, and what became of it.

The picture sheet of registered scans: the mesh in each, coloured by how far it is off.
"""

import math
import textwrap
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lipservo.terminal.pictures import save_picture, without_screen
from lipservo_lab.scans.head_alignment import Template
from lipservo_lab.scans.scan import vertex_normals
from lipservo_lab.scans.scan_import import SampleScan
from lipservo_lab.video.face_track import FaceSample
from lipservo_lab.video.track_quality import ClipReport
from lipsync.arrays import Array, Indices
from lipsync.markers import INNER_LIP, OUTER_LIP

_COLUMNS, _INCHES = 6, 2.2
#: The colour scale ends here; grey is where a scan has no surface.
_MOST_MM = 1.0
_GREY = 0.6


def draw_scans(samples: Sequence[SampleScan], template: Template, picture: Path) -> None:
    """Draw registered scans from the front into one picture file, coloured by their errors.

    Head motion is removed. Raises OutputError.
    """
    without_screen()
    from matplotlib import colormaps
    from matplotlib import pyplot as plt
    from matplotlib.cm import ScalarMappable
    from matplotlib.collections import PolyCollection

    n_rows = max(1, math.ceil(len(samples) / _COLUMNS))
    figure, axes = plt.subplots(
        n_rows, _COLUMNS, figsize=(_COLUMNS * _INCHES, n_rows * _INCHES * 1.25), squeeze=False
    )
    for axis in axes.flat:
        axis.axis("off")
    scale = colormaps["turbo"]
    for axis, sample in zip(axes.flat, samples, strict=False):
        order = _visible_back_to_front(sample.points_mm, template.triangles)
        outlines = sample.points_mm[template.triangles[order]][:, :, :2]
        missing = np.isnan(sample.errors_mm)
        colours = scale(np.clip(np.nan_to_num(sample.errors_mm) / _MOST_MM, 0.0, 1.0))[:, :3]
        colours[missing] = _GREY
        # Surfaces are the brighter the more they face the viewer.
        brightness = 0.35 + 0.65 * np.clip(
            vertex_normals(sample.points_mm, template.triangles)[:, 2], 0, 1
        )
        shaded = (colours * brightness[:, None])[template.triangles[order]].mean(axis=1)
        axis.add_collection(PolyCollection(list(outlines), facecolors=shaded, edgecolors="face"))
        axis.set_aspect("equal")
        axis.autoscale_view()
        report = sample.report
        axis.set_title(
            f"{report.take}/{report.scan}\n{report.error_mm:.2f} mm, {report.matched:.0%}",
            fontsize=7,
        )
    figure.subplots_adjust(left=0.01, right=0.93, bottom=0.02, top=0.94, wspace=0.05)
    bar = figure.add_axes((0.945, 0.2, 0.012, 0.6))
    mappable = ScalarMappable(cmap=scale)
    mappable.set_clim(0.0, _MOST_MM)
    figure.colorbar(mappable, cax=bar, label="off the scan, mm; grey: no surface there")
    save_picture(figure, picture)
    plt.close(figure)


def _visible_back_to_front(points: Array, triangles: Indices) -> Indices:
    """Return the numbers of the triangles that face the viewer, (n,), the farthest first."""
    corners = points[triangles]
    ahead = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] > 0.0
    order = np.argsort(corners[:, :, 2].mean(axis=1))
    return np.asarray(order[ahead[order]], dtype=np.int64)


#: More faces than this nobody looks at; of more, so many are drawn, evenly chosen.
_MOST, _FACE_SHEET_COLUMNS = 120, 8
_FACE_SHEET_INCHES = 1.5


def draw_sheet(samples: Sequence[tuple[FaceSample, ClipReport]], picture: Path) -> None:
    """Draw tracked faces with points and lips into one picture file.

    Clips that were left out have a red title, and come first. Raises OutputError.
    """
    without_screen()
    from matplotlib import pyplot as plt

    # What was left out is what one looks for.
    drawn = sorted(samples[:: math.ceil(len(samples) / _MOST) or 1], key=_is_used)
    n_rows = max(1, math.ceil(len(drawn) / _FACE_SHEET_COLUMNS))
    figure, axes = plt.subplots(
        n_rows,
        _FACE_SHEET_COLUMNS,
        figsize=(_FACE_SHEET_COLUMNS * _FACE_SHEET_INCHES, n_rows * _FACE_SHEET_INCHES * 1.3),
        squeeze=False,
    )
    for axis in axes.flat:
        axis.axis("off")
    for axis, (sample, report) in zip(axes.flat, drawn, strict=False):
        axis.imshow(sample.picture)
        axis.plot(*sample.points.T, ",", color="#40ff60")
        for ring in (OUTER_LIP, INNER_LIP):
            axis.plot(*sample.points[[*ring, ring[0]]].T, color="#ff3030", linewidth=0.7)
        axis.set_xlim(0, sample.picture.shape[1])
        axis.set_ylim(sample.picture.shape[0], 0)
        axis.set_title(_title(report), fontsize=6, color="red" if report.left_out else "black")
    figure.tight_layout()
    save_picture(figure, picture)
    plt.close(figure)


def _is_used(sample: tuple[FaceSample, ClipReport]) -> bool:
    return sample[1].left_out is None


def _title(report: ClipReport) -> str:
    if report.left_out is not None:
        return "\n".join(textwrap.wrap(f"{report.clip}: {report.left_out}", 28)[:3])
    return f"{report.clip}\n{report.shift_ms:+d} ms, r {report.gap_r:.2f}"
