"""A folder of pictures of one face with coloured dots, one a pose, and what the dots are called.

`dots.csv` in the folder names every dot where it is in one of the pictures, in pixels from the top
left: `marker,column_px,row_px`. Its size comes from a ruler: `mm_per_px` in a fourth column, the
same in every row. Pictures end in the number of their pose: `pose_7.png`. Needs OpenCV, the extra
`dots`.
"""

import csv
import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.calibration import CalibrationError
from calibration.capture.coloured_dots import (
    DotColour,
    FoundDots,
    dots_mm,
    find_dots,
    name_dots,
)
from calibration.capture.pose_pictures import pose_pictures
from lipsync.arrays import Array

Reading = tuple[int, str, Array]

NAMES_FILE = "dots.csv"
_COLUMNS = ("marker", "column_px", "row_px", "mm_per_px")
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


class DotsFolder:
    """Pictures as they come; all of one size, for `dots.csv` counts in pixels."""

    def __init__(self, folder: Path, tell: Callable[[str], None] = lambda _: None) -> None:
        """tell: hears of dots that touch, or that no picture shows, a line for each picture.

        Raises CalibrationError for a `dots.csv` that is not as described above.
        """
        self._folder, self._tell = folder, tell
        self._names = read_names(folder / NAMES_FILE)
        self._first: tuple[str, tuple[int, int]] | None = None
        self._told: set[str] = set()

    def readings(self, pose: int) -> list[Reading]:
        """What is seen of one pose. Raises CalibrationError."""
        pictures = pose_pictures(self._folder)
        return [
            each for number, path in pictures if number == pose for each in self._look(number, path)
        ]

    def all_readings(self) -> list[Reading]:
        """Of every picture. Raises CalibrationError."""
        pictures = pose_pictures(self._folder)
        if not pictures:
            raise CalibrationError(f"{self._folder}: no picture in it; expected pose_1.png, ...")
        return [each for number, path in pictures for each in self._look(number, path)]

    def _look(self, pose: int, picture: Path) -> list[Reading]:
        names = self._names
        found = find_dots(picture, DotColour())
        self._check_size(picture.name, found.size_px)
        places_px = name_dots(
            found.middles_px,
            names.first_px,
            furthest_px=_FURTHEST_MM / names.mm_per_px,
            sure_px=_SURE_MM / names.mm_per_px,
        )
        self._tell_of(picture.name, found, places_px)
        origin_px = np.mean(list(names.first_px.values()), axis=0)
        places_mm = dots_mm(places_px, origin_px, names.mm_per_px)
        return [(pose, name, place_mm) for name, place_mm in places_mm.items()]

    def _check_size(self, name: str, size_px: tuple[int, int]) -> None:
        self._first = self._first or (name, size_px)
        first, wanted = self._first
        if size_px != wanted:
            raise CalibrationError(
                f"{self._folder}: {name} is {size_px[1]} x {size_px[0]} pixels, {first} "
                f"{wanted[1]} x {wanted[0]}; take all of them with one camera that stands still"
            )

    def _tell_of(self, picture: str, found: FoundDots, places_px: Mapping[str, Array]) -> None:
        n_lost = sum(bool(np.isnan(place).any()) for place in places_px.values())
        remarks = []
        if found.n_merged:
            remarks.append(f"dots that touch, told apart by shape: {2 * found.n_merged}")
        if n_lost == len(places_px):
            remarks.append(
                f"left out: {len(found.middles_px)} dots are seen of {n_lost}, and names would be "
                "a guess"
            )
        elif n_lost:
            remarks.append(f"{n_lost} dots are not seen")
        for remark in remarks:
            line = f"{picture}: {remark}"
            if line not in self._told:
                self._told.add(line)
                self._tell(line)


def read_dots_folder(folder: Path, only: int | None = None) -> list[Reading]:
    """Pose, marker, place (3,) in mm of every dot; NaN for one that is hidden; only: one pose.

    The middle of the named dots is the origin. Raises CalibrationError, with file and line.
    """
    pictures = DotsFolder(folder)
    return pictures.all_readings() if only is None else pictures.readings(only)


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
