"""A folder of pictures of one face with coloured dots, one a pose, and what the dots are called.

`dots.csv` in the folder names every dot where it is in one of the pictures, in pixels from the top
left: `marker,column_px,row_px`. Its size comes from a ruler: `mm_per_px` in a fourth column, the
same in every row. Pictures end in the number of their pose: `pose_7.png`. Needs OpenCV, the extra
`video`.
"""

import csv
import io
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.calibration import CalibrationError
from calibration.capture.coloured_dots import DotColour, dots_mm, find_dots_px, name_dots
from lipsync.arrays import Array

NAMES_FILE = "dots.csv"
_COLUMNS = ("marker", "column_px", "row_px", "mm_per_px")
_PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
#: A dot is looked for as far from its first place as a wide open jaw carries it, not farther. All
#: dots of a picture are named together; when one is hidden, the others are believed within the way
#: that lips and corners go.
_FURTHEST_MM, _SURE_MM = 60.0, 10.0


@dataclass(frozen=True, slots=True)
class DotNames:
    """Where each dot was when it was named, (2,) pixels, and the scale."""

    first_px: dict[str, Array]
    mm_per_px: float


def is_dots_folder(folder: Path) -> bool:
    """Whether this folder is one of pictures: it says what their dots are called."""
    return (folder / NAMES_FILE).is_file()


def read_dots_folder(folder: Path, only: int | None = None) -> list[tuple[int, str, Array]]:
    """Pose, marker, place (3,) in mm of every dot; NaN for one that is hidden; only: one pose.

    The middle of the named dots is the origin. Raises CalibrationError, with file and line.
    """
    names = read_names(folder / NAMES_FILE)
    origin_px = np.mean(list(names.first_px.values()), axis=0)
    readings = []
    for pose, picture in _pictures(folder):
        if only is not None and pose != only:
            continue
        found_px = find_dots_px(picture, DotColour())
        places_px = name_dots(
            found_px,
            names.first_px,
            furthest_px=_FURTHEST_MM / names.mm_per_px,
            sure_px=_SURE_MM / names.mm_per_px,
        )
        for name, place_mm in dots_mm(places_px, origin_px, names.mm_per_px).items():
            readings.append((pose, name, place_mm))
    return readings


def _pictures(folder: Path) -> list[tuple[int, Path]]:
    pictures = []
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() not in _PICTURES:
            continue
        numbers = re.findall(r"\d+", path.stem)
        if not numbers:
            raise CalibrationError(f"{path}: no pose number in the name; call it pose_1.png")
        pictures.append((int(numbers[-1]), path))
    return pictures


def read_names(path: Path) -> DotNames:
    """Raises CalibrationError for anything that is not as described above."""
    try:
        rows = list(csv.DictReader(io.StringIO(path.read_text(encoding="utf-8-sig"))))
    except (OSError, UnicodeDecodeError) as error:
        raise CalibrationError(f"{path}: cannot be read as text") from error
    first_px: dict[str, Array] = {}
    scales = set()
    for number, row in enumerate(rows):
        try:
            name, column, line, scale = (row[key] for key in _COLUMNS)
            first_px[str(name)] = np.array([float(column), float(line)])
            scales.add(float(scale))
        except (KeyError, TypeError, ValueError) as error:
            raise CalibrationError(
                f"{path}, line {number + 2}: expected {','.join(_COLUMNS)}"
            ) from error
    if len(scales) != 1 or not 0.0 < max(scales) < np.inf or len(first_px) != len(rows):
        raise CalibrationError(
            f"{path}: expected one line for each dot, with the same mm_per_px above 0 in all"
        )
    return DotNames(first_px, scales.pop())
