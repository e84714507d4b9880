"""The picture sheet of registered scans: the mesh in each, coloured by how far it is off."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lipservo.terminal.pictures import save_picture, without_screen
from lipservo_lab.scans.scan import vertex_normals
from lipservo_lab.scans.scan_import import SampleScan
from lipservo_lab.scans.template import Template
from lipsync.arrays import Array, Indices

_COLUMNS, _INCHES = 6, 2.2
#: The colour scale ends here; grey is where a scan has no surface.
_MOST_MM = 1.0
_GREY = 0.6


def draw_scans(samples: Sequence[SampleScan], template: Template, picture: Path) -> None:
    """The faces from the front, shaded, without the motion of the head. Raises OutputError."""
    without_screen()
    from matplotlib import colormaps
    from matplotlib import pyplot as plt
    from matplotlib.cm import ScalarMappable
    from matplotlib.collections import PolyCollection

    n_rows = max(1, math.ceil(len(samples) / _COLUMNS))
    figure, axes = plt.subplots(
        n_rows, _COLUMNS, figsize=(_COLUMNS * _INCHES, n_rows * _INCHES * 1.25), squeeze=False
    )
    for place in axes.flat:
        place.axis("off")
    scale = colormaps["turbo"]
    for place, sample in zip(axes.flat, samples, strict=False):
        order = _back_to_front(sample.points_mm, template.triangles)
        corners = sample.points_mm[template.triangles[order]][:, :, :2]
        missing = np.isnan(sample.errors_mm)
        colours = scale(np.clip(np.nan_to_num(sample.errors_mm) / _MOST_MM, 0.0, 1.0))[:, :3]
        colours[missing] = _GREY
        light = 0.35 + 0.65 * np.clip(
            vertex_normals(sample.points_mm, template.triangles)[:, 2], 0, 1
        )
        shaded = (colours * light[:, None])[template.triangles[order]].mean(axis=1)
        place.add_collection(PolyCollection(list(corners), facecolors=shaded, edgecolors="face"))
        place.set_aspect("equal")
        place.autoscale_view()
        report = sample.report
        place.set_title(
            f"{report.take}/{report.scan}\n{report.error_mm:.2f} mm, {report.matched:.0%}",
            fontsize=7,
        )
    figure.subplots_adjust(left=0.01, right=0.93, bottom=0.02, top=0.94, wspace=0.05)
    bar = figure.add_axes((0.945, 0.2, 0.012, 0.6))
    mapped = ScalarMappable(cmap=scale)
    mapped.set_clim(0.0, _MOST_MM)
    figure.colorbar(mapped, cax=bar, label="off the scan, mm; grey: no surface there")
    save_picture(figure, picture)
    plt.close(figure)


def _back_to_front(points: Array, triangles: Indices) -> Indices:
    """The triangles that face the viewer, the farthest first."""
    corner = points[triangles]
    ahead = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])[:, 2] > 0.0
    order = np.argsort(corner[:, :, 2].mean(axis=1))
    return np.asarray(order[ahead[order]], dtype=np.int64)
