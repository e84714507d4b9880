"""Coloured dots on a robot's face, found in a folder of pictures from the front, one per pose.

A dot is known by its colour and its shape: a disc, or an ellipse when seen at an angle, about as
large as the other dots. A shirt of that colour is ignored. A single camera measures across and up;
forward is given as 0, so the calibration learns nothing of it. `dots.csv` in the folder gives every
dot's name and its position in one of the pictures, in pixels from the top left:
`marker,column_px,row_px`. The scale, measured with a ruler, is in a fourth column, `mm_per_px`,
equal in every row. Pictures end in the number of their pose: `pose_7.png`.
Needs OpenCV, the extra `dots`; imported only when pictures are read. Loads SciPy.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from scipy.optimize import linear_sum_assignment

from calibration.calibration import CalibrationError
from calibration.capture.marker_files import Reading, csv_rows, number_in
from lipsync.arrays import Array
from lipsync.errors import check_extra

#: What every reader here reads.
PICTURES: Final = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
#: What phones and cameras write besides, and nobody here reads.
_FOREIGN: Final = (".heic", ".heif", ".dng", ".cr2", ".nef", ".arw", ".webp", ".gif")


def pose_pictures(folder: Path, pose: int | None = None) -> list[tuple[int, Path]]:
    """Return pose number and path of the pictures in a folder, sorted by file name.

    pose: the only pose whose pictures are returned, which may have none; None: all poses. Raises
    CalibrationError for a picture whose name has no number or whose format is not read, and, for
    all poses, if there is no picture.
    """
    pictures = []
    for path in sorted(folder.iterdir()):
        ending = path.suffix.lower()
        if path.name.startswith(".") or ending not in (*PICTURES, *_FOREIGN):
            continue
        if ending in _FOREIGN:
            raise CalibrationError(f"{path}: {ending} files are not read; save it as .jpg or .png")
        numbers = re.findall(r"\d+", path.stem)
        if not numbers:
            raise CalibrationError(f"{path}: its name has no pose number; call it pose_1.png")
        if pose in (None, int(numbers[-1])):
            pictures.append((int(numbers[-1]), path))
    if pose is None and not pictures:
        raise CalibrationError(f"{folder}: no picture in this folder; expected pose_1.png, ...")
    return pictures


def holds_pictures(folder: Path) -> bool:
    """Return whether a folder contains any picture, in a supported format or not."""
    return any(path.suffix.lower() in (*PICTURES, *_FOREIGN) for path in folder.iterdir())


#: What is to be said wherever dots are used.
PROTRUSION_IS_UNSEEN = (
    "one camera from the front sees neither protrusion nor whether it stands to a side, above or "
    "below: set it level, straight in front; dots have no forward place, and joints that push the "
    "lips forward are judged by what they do across and up"
)
#: Dots are of one size: a spot is none that is so much larger or smaller than the middle one, and
#: one that is so much larger and as long is two that touch, as those of closed lips do. The pixels
#: of a small dot come and go with where it lies on the grid: 15 % of its area at 12 pixels, so that
#: the area alone splits single dots.
_SMALLEST, _LARGEST = 0.35, 2.6
_TWO_DOTS, _TWO_DOTS_LONG = 1.4, 1.35
#: A disc at 60 degrees to the camera is twice as long as wide.
_MOST_LENGTH = 2.2
#: What an ellipse of the same spread would cover, a spot covers at least so much of: an
#: irregular one, or one with holes, covers less.
_LEAST_FILL = 0.8


#: Blue: least hue (OpenCV's, 0..179), saturation and brightness, and the most of them.
_LEAST_HSV, _MOST_HSV = (100, 120, 60), (130, 255, 255)


@dataclass(frozen=True, slots=True)
class FoundDots:
    """The dots found in a picture. size_px: the picture's height and width.

    middles_px: (n, 2), column and row of every dot; n_merged: number of spots that are two touching
    dots, both of which are in middles_px.
    """

    middles_px: Array
    size_px: tuple[int, int]
    n_merged: int = 0


@dataclass(frozen=True, slots=True)
class _Spot:
    """A connected region of pixels of one colour. length: ratio of its long axis to its short one.

    pixels: (n, 2), column and row; filled: its area over that of an ellipse of equal variances.
    """

    pixels: Array
    area_px: float
    length: float
    filled: float

    @property
    def is_round(self) -> bool:
        """Whether the spot is shaped like one dot: not too long, and an ellipse without gaps."""
        return self.length <= _MOST_LENGTH and self.filled >= _LEAST_FILL


def find_dots(picture: Path, *, least_area_px: int = 12) -> FoundDots:
    """Return every blue dot in a picture; spots below `least_area_px` are ignored.

    Raises CalibrationError if the file is not a picture, MissingExtraError without OpenCV.
    """
    check_extra("cv2", f"{picture}: finding dots")
    import cv2

    pixels = cv2.imread(str(picture))
    if pixels is None:
        raise CalibrationError(f"{picture}: not readable as a picture")
    # Pixels of the dots' colour, in connected spots.
    hsv = cv2.cvtColor(pixels, cv2.COLOR_BGR2HSV)
    mask = cv2.inRange(hsv, np.array(_LEAST_HSV), np.array(_MOST_HSV))
    n_spots, labels, stats, _ = cv2.connectedComponentsWithStats(mask)
    spots = []
    for label in range(1, n_spots):  # the first is what is not of that colour
        left, top, width, height, area_px = (int(value) for value in stats[label])
        if area_px >= least_area_px:
            rows, columns = np.nonzero(labels[top : top + height, left : left + width] == label)
            places = np.column_stack((columns + left, rows + top)).astype(np.float64)
            spots.append(_measure_spot(places))
    return _select_dots(spots, pixels.shape[:2])


def _measure_spot(pixels: Array) -> _Spot:
    """Return the spot that `pixels`, (n, 2) columns and rows, form, with its measures of shape."""
    # Variances along both axes of the spot; a pixel is a square, which adds a twelfth.
    variances = np.linalg.eigvalsh(np.cov(pixels.T, bias=True)) + 1.0 / 12.0
    area_px = float(len(pixels))
    ellipse_px = 4.0 * np.pi * float(np.sqrt(variances.prod()))
    return _Spot(pixels, area_px, float(np.sqrt(variances[1] / variances[0])), area_px / ellipse_px)


def _select_dots(spots: list[_Spot], size_px: tuple[int, int]) -> FoundDots:
    """Return the dots among the spots of the dots' colour in a picture.

    size_px: the picture's height and width. Dots are about as large as the usual one; a spot of two
    touching dots becomes two dots, and any other spot is left out.
    """
    usual_area_px, usual_length = _usual_size(spots)
    middles_px: list[Array] = []
    n_merged = 0
    for spot in spots:
        size_ratio = spot.area_px / usual_area_px
        # Dots seen at an angle are all long, and two that touch may then be rounder than the usual
        # one.
        length_ratio = max(spot.length / usual_length, usual_length / spot.length)
        if _TWO_DOTS <= size_ratio <= _LARGEST and length_ratio >= _TWO_DOTS_LONG:
            middles_px.extend(_two_dots(spot.pixels))
            n_merged += 1
        elif spot.is_round and _SMALLEST <= size_ratio <= _LARGEST:
            middles_px.append(spot.pixels.mean(axis=0))
    return FoundDots(np.array(middles_px, dtype=np.float64).reshape(-1, 2), size_px, n_merged)


def _usual_size(spots: list[_Spot]) -> tuple[float, float]:
    """Return a usual dot's area in pixels and its ratio of long to short axis.

    Both are medians over round spots of the most frequent size; 1 and 1 without round spots.
    """
    round_spots = [spot for spot in spots if spot.is_round]
    if not round_spots:
        return 1.0, 1.0
    areas = np.array([spot.area_px for spot in round_spots])
    # Which spots are of nearly one size; the sizes with the most alike spots are the usual ones.
    is_alike = np.abs(np.log(areas[:, None] / areas)) < np.log(_TWO_DOTS)
    is_frequent = is_alike.sum(axis=1) == is_alike.sum(axis=1).max()
    is_usual = is_alike[is_frequent].any(axis=0)
    lengths = np.array([spot.length for spot in round_spots])
    return float(np.median(areas[is_usual])), float(np.median(lengths[is_usual]))


def _two_dots(pixels: Array) -> Array:
    """Return the centres, (2, 2) pixels, of the two equal discs that a spot's `pixels` consist of.

    The variance along the line between two discs d apart is d^2 / 4 greater than across it.
    """
    variances, axes = np.linalg.eigh(np.cov(pixels.T))
    # Half the distance of the discs, along the axis of greatest variance.
    half_apart = np.sqrt(max(0.0, variances[1] - variances[0])) * axes[:, 1]
    middle = pixels.mean(axis=0)
    return np.array([middle - half_apart, middle + half_apart])


def name_dots(
    dots_px: Array, expected_px: Mapping[str, Array], *, furthest_px: float, sure_px: float
) -> dict[str, Array]:
    """Assign dots of a picture to expected dots, with the least sum of squared distances.

    So dots in a row keep their order. A dot is NaN where no found dot is within `furthest_px`. All
    are NaN when one is hidden while another moved farther than `sure_px`: a row with a gap may have
    moved up by one position, and a wrong name is worse than none.

    Parameters
    ----------
    dots_px : Array
        (n, 2) pixels.
    expected_px : Mapping[str, Array]
        (2,) pixels by name: column and row.
    furthest_px,sure_px : float
        Largest distance of a match, and the largest that is sure while a dot is hidden.

    Returns
    -------
    dict[str, Array]
        (2,) pixels by name, NaN where not found.
    """
    names = list(expected_px)
    places_px = {name: np.full(2, np.nan) for name in names}
    if not len(dots_px):
        return places_px
    expected = np.array([expected_px[name] for name in names])
    distances_px = np.linalg.norm(expected[:, None] - dots_px, axis=2)
    # Beyond the furthest distance every pair costs the same: it is no match.
    for row, column in zip(
        *linear_sum_assignment(np.minimum(distances_px, furthest_px) ** 2), strict=True
    ):
        if distances_px[row, column] <= furthest_px:
            places_px[names[row]] = dots_px[column]
    moved_px = [np.linalg.norm(places_px[name] - expected_px[name]) for name in names]
    if np.isnan(moved_px).any() and np.nanmax(moved_px, initial=0.0) > sure_px:
        return {name: np.full(2, np.nan) for name in names}
    return places_px


def dots_mm(places_px: Mapping[str, Array], origin_px: Array, mm_per_px: float) -> dict[str, Array]:
    """Return dots in mm: across to the robot's left (right in its picture), up, and 0 forward.

    Parameters
    ----------
    places_px : Mapping[str, Array]
        (2,) pixels by name: column and row.
    origin_px : Array
        (2,) pixels of the point that becomes 0.
    mm_per_px : float
        Millimetres of a pixel.

    Returns
    -------
    dict[str, Array]
        (3,) mm by name.
    """
    return {
        name: np.array([place[0] - origin_px[0], origin_px[1] - place[1], 0.0 * place[0]])
        * mm_per_px
        for name, place in places_px.items()
    }


NAMES_FILE = "dots.csv"
_COLUMNS = ("marker", "column_px", "row_px", "mm_per_px")
#: A dot is looked for as far from its first place as a wide open jaw carries it, not farther. All
#: dots of a picture are named together; when one is hidden, the others are believed within the way
#: that lips and corners go.
_FURTHEST_MM, _SURE_MM = 60.0, 10.0


@dataclass(frozen=True, slots=True)
class DotNames:
    """The content of `dots.csv`: each named dot's column and row, (2,) pixels, and the scale."""

    first_px: dict[str, Array]
    mm_per_px: float


def is_dots_folder(folder: Path) -> bool:
    """Return whether a folder contains `dots.csv`, which names the dots of its pictures."""
    return (folder / NAMES_FILE).is_file()


class DotsFolder:
    """Reader of dots in a folder of pictures of one size, to which pictures may still be added."""

    def __init__(self, folder: Path, tell: Callable[[str], None] = lambda _: None) -> None:
        """Read `dots.csv`. tell: called with a line for each picture with touching or hidden dots.

        Raises CalibrationError for a `dots.csv` that lacks a column, has a cell that is no number,
        or rows that differ in mm_per_px.
        """
        self._folder, self._tell = folder, tell
        self._names = read_names(folder / NAMES_FILE)
        self._first_picture: tuple[str, tuple[int, int]] | None = None
        self._reported: set[str] = set()

    def readings(self, pose: int | None = None) -> list[Reading]:
        """Return pose, marker and position (3,) in mm, NaN if hidden, of every dot.

        pose: the number of the pose whose picture is read; None reads all pictures. The origin is
        the mean of the dots in `dots.csv`. Raises CalibrationError for a picture that is unusable
        or differs in size from the first, and, if pose is None, for a folder without pictures.
        """
        return [
            each
            for number, path in pose_pictures(self._folder, pose)
            for each in self._read_picture(number, path)
        ]

    def _read_picture(self, pose: int, picture: Path) -> list[Reading]:
        """Find the dots in a picture; return a reading for each named dot, NaN for a hidden one.

        Raises CalibrationError for an unreadable picture, or one not as large as the first.
        """
        names = self._names
        dots = find_dots(picture)
        self._check_size(picture.name, dots.size_px)
        places_px = name_dots(
            dots.middles_px,
            names.first_px,
            furthest_px=_FURTHEST_MM / names.mm_per_px,
            sure_px=_SURE_MM / names.mm_per_px,
        )
        self._report_dots(picture.name, dots, places_px)
        origin_px = np.mean(list(names.first_px.values()), axis=0)
        places_mm = dots_mm(places_px, origin_px, names.mm_per_px)
        return [(pose, name, place_mm) for name, place_mm in places_mm.items()]

    def _check_size(self, name: str, size_px: tuple[int, int]) -> None:
        """Raise CalibrationError if a picture is not as large as the first one checked.

        name: the picture's file name; size_px: height and width.
        """
        self._first_picture = self._first_picture or (name, size_px)
        first_name, ref_px = self._first_picture
        if size_px != ref_px:
            raise CalibrationError(
                f"{self._folder}: {name} has {size_px[1]} x {size_px[0]} pixels, but {first_name} "
                f"{ref_px[1]} x {ref_px[0]}; take all pictures with one camera that stands still"
            )

    def _report_dots(self, picture: str, dots: FoundDots, places_px: Mapping[str, Array]) -> None:
        """Report a picture's touching and hidden dots to the user, each remark on a picture once.

        picture: the file's name; places_px: (2,) pixels of each named dot, NaN where hidden.
        """
        n_lost = sum(bool(np.isnan(place).any()) for place in places_px.values())
        remarks = []
        if dots.n_merged:
            remarks.append(f"dots that touch, separated by shape: {2 * dots.n_merged}")
        if n_lost == len(places_px):
            remarks.append(
                f"left out: {len(dots.middles_px)} dots are seen of {n_lost}, and names would be "
                "a guess"
            )
        elif n_lost:
            remarks.append(f"{n_lost} dots are not seen")
        for remark in remarks:
            line = f"{picture}: {remark}"
            if line not in self._reported:
                self._reported.add(line)
                self._tell(line)


def read_names(path: Path) -> DotNames:
    """Return each dot's name, position in pixels and the scale from a `dots.csv`.

    Raises CalibrationError for a missing column or number, a repeated name, or differing scales.
    """
    rows = list(csv_rows(path, _COLUMNS))
    first_px: dict[str, Array] = {}
    for place, row in rows:
        pixels = [number_in(row[key], place) for key in _COLUMNS[1:3]]
        first_px[str(row["marker"])] = np.array(pixels)
    scales = {number_in(row["mm_per_px"], place) for place, row in rows}
    if len(scales) != 1 or not 0.0 < max(scales) < np.inf or len(first_px) != len(rows):
        raise CalibrationError(
            f"{path}: every dot needs one line, and all lines the same mm_per_px above 0"
        )
    return DotNames(first_px, scales.pop())
