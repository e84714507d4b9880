"""Pictures of blue dots on a simulated face, one a pose, for the way by coloured dots.

Seen from the front by a camera far away: no perspective, so that what depth costs is that alone
which one camera does not see. Needs OpenCV, the extra `dots`.
"""

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calibration.capture.dots_folder import NAMES_FILE
from lipsync.arrays import Array

_PX_PER_MM, _DOT_MM, _MARGIN_MM = 4.0, 2.5, 15.0
#: Drawn so much larger first: edges of dots are soft.
_FINER = 4
_BLUE, _SKIN = (200, 60, 20), (120, 150, 200)
_BLUR_PX, _NOISE = 0.8, 6.0


def write_dots_pictures(
    folder: Path, marker_names: Sequence[str], markers_mm: Array, seed: int
) -> None:
    """`pose_1.png` and so on for (n, n_markers, 3), and `dots.csv` by the first of them."""
    import cv2

    flat_mm = markers_mm[..., :2]
    left_mm, low_mm = flat_mm.min(axis=(0, 1)) - _MARGIN_MM
    right_mm, high_mm = flat_mm.max(axis=(0, 1)) + _MARGIN_MM
    size_px = (round(_PX_PER_MM * (right_mm - left_mm)), round(_PX_PER_MM * (high_mm - low_mm)))
    places_px = _PX_PER_MM * np.stack([flat_mm[..., 0] - left_mm, high_mm - flat_mm[..., 1]], 2)
    noise = np.random.default_rng([seed, 41])
    for pose, dots_px in enumerate(places_px):
        large = np.full((size_px[1] * _FINER, size_px[0] * _FINER, 3), _SKIN, np.uint8)
        radius = round(_FINER * _PX_PER_MM * _DOT_MM / 2)
        for column, row in dots_px:
            middle = (round(_FINER * (column + 0.5)), round(_FINER * (row + 0.5)))
            cv2.circle(large, middle, radius, _BLUE, -1, cv2.LINE_AA)
        small = cv2.resize(large, size_px, interpolation=cv2.INTER_AREA).astype(np.float64)
        soft = cv2.GaussianBlur(small, (0, 0), _BLUR_PX)
        picture = np.clip(soft + noise.normal(0.0, _NOISE, soft.shape), 0, 255).astype(np.uint8)
        cv2.imwrite(str(folder / f"pose_{pose + 1}.png"), picture)
    with (folder / NAMES_FILE).open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["marker", "column_px", "row_px", "mm_per_px"])
        for name, (column, row) in zip(marker_names, places_px[0], strict=True):
            writer.writerow([name, round(column, 2), round(row, 2), 1.0 / _PX_PER_MM])
