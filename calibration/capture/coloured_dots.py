"""Coloured dots on a face, found in pictures from the front: one picture a pose.

A dot is told by its colour and its shape: a disc, seen at an angle an ellipse, and as large as the
others. A shirt of that colour is none. A single camera sees across and up; forward is given as 0,
so the calibration learns nothing of it. Needs OpenCV, the extra `dots`; imported only when pictures
are read. Loads SciPy.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import linear_sum_assignment

from calibration.calibration import CalibrationError
from lipsync.arrays import Array
from lipsync.extras import check_extra

#: What is to be said wherever dots are used.
PROTRUSION_IS_UNSEEN = (
    "one camera from the front does not see protrusion: dots have no forward place, and joints "
    "that push the lips forward are judged by what they do across and up"
)
#: Dots are of one size: a spot is none that is so much larger or smaller than the middle one, and
#: one that is so much larger and as long is two that touch, as those of closed lips do. The pixels
#: of a small dot come and go with where it lies on the grid: 15 % of its area at 12 pixels, so that
#: the area alone splits single dots.
_SMALLEST, _LARGEST = 0.35, 2.6
_TWO_DOTS, _TWO_DOTS_LONG = 1.4, 1.35
#: A disc at 60 degrees to the camera is twice as long as wide.
_LONGEST = 2.2
#: What an ellipse of the same spread would cover, a spot covers at least so much of: an
#: irregular one, or one with holes, covers less.
_LEAST_FILLED = 0.8


@dataclass(frozen=True, slots=True)
class DotColour:
    """A range of OpenCV's hue 0..179, and the least saturation and brightness, 0..255.

    The default is blue: neither skin, lips, nor most rubber.
    """

    least_hue: int = 100
    most_hue: int = 130
    least_saturation: int = 120
    least_brightness: int = 60


@dataclass(frozen=True, slots=True)
class FoundDots:
    """What a picture holds. size_px: its height and width.

    middles_px: (n, 2), column and row of every dot; n_merged: how many pairs touch, each counted as
    the two dots that it is; n_other: spots of that colour that are no dots.
    """

    middles_px: Array
    size_px: tuple[int, int]
    n_merged: int = 0
    n_other: int = 0


@dataclass(frozen=True, slots=True)
class _Spot:
    """Pixels of one colour that hang together. length: of its long axis over its short one."""

    pixels: Array
    area_px: float
    length: float
    filled: float

    @property
    def is_round(self) -> bool:
        """Whether it may be one dot."""
        return self.length <= _LONGEST and self.filled >= _LEAST_FILLED


def find_dots(picture: Path, colour: DotColour, *, least_area_px: int = 12) -> FoundDots:
    """Every dot of that colour.

    Raises CalibrationError for what is not a picture, MissingExtraError without OpenCV.
    """
    check_extra("cv2", f"{picture}: finding dots")
    import cv2

    pixels = cv2.imread(str(picture))
    if pixels is None:
        raise CalibrationError(f"{picture}: not readable as a picture")
    low = (colour.least_hue, colour.least_saturation, colour.least_brightness)
    high = (colour.most_hue, 255, 255)
    mask = cv2.inRange(cv2.cvtColor(pixels, cv2.COLOR_BGR2HSV), np.array(low), np.array(high))
    n_spots, labels, stats, _ = cv2.connectedComponentsWithStats(mask)
    spots = []
    for label in range(1, n_spots):  # the first is what is not of that colour
        left, top, width, height, area_px = (int(value) for value in stats[label])
        if area_px >= least_area_px:
            inside = labels[top : top + height, left : left + width] == label
            rows, columns = np.nonzero(inside)
            places = np.column_stack((columns + left, rows + top)).astype(np.float64)
            spots.append(_spot(places))
    return _dots_among(spots, pixels.shape[:2])


def find_dots_px(picture: Path, colour: DotColour, *, least_area_px: int = 12) -> Array:
    """(n, 2): column and row of the middle of every dot; as `find_dots`."""
    return find_dots(picture, colour, least_area_px=least_area_px).middles_px


def _spot(pixels: Array) -> _Spot:
    """pixels: (n, 2). The pixels of an ellipse spread by a quarter of its half axes, squared."""
    # A pixel is a square: it spreads by a twelfth of itself.
    spread = np.linalg.eigvalsh(np.cov(pixels.T, bias=True)) + 1.0 / 12.0
    area_px = float(len(pixels))
    ellipse_px = 4.0 * np.pi * float(np.sqrt(spread.prod()))
    return _Spot(pixels, area_px, float(np.sqrt(spread[1] / spread[0])), area_px / ellipse_px)


def _dots_among(spots: list[_Spot], size_px: tuple[int, int]) -> FoundDots:
    usual_px, usual_length = _usual(spots)
    middles: list[Array] = []
    n_merged = n_other = 0
    for spot in spots:
        size = spot.area_px / usual_px
        # Of dots that are seen at an angle all are long, and two of them may be less so.
        unlike = max(spot.length / usual_length, usual_length / spot.length)
        if _TWO_DOTS <= size <= _LARGEST and unlike >= _TWO_DOTS_LONG:
            middles.extend(_two_dots(spot.pixels))
            n_merged += 1
        elif spot.is_round and _SMALLEST <= size <= _LARGEST:
            middles.append(spot.pixels.mean(axis=0))
        else:
            n_other += 1
    places = np.array(middles, dtype=np.float64).reshape(-1, 2)
    return FoundDots(places, size_px, n_merged, n_other)


def _usual(spots: list[_Spot]) -> tuple[float, float]:
    """Area and length of one dot: those that most spots are near to; a shirt may be round too."""
    alone = [spot for spot in spots if spot.is_round]
    if not alone:
        return 1.0, 1.0
    areas = np.array([spot.area_px for spot in alone])
    near = np.abs(np.log(areas[:, None] / areas)) < np.log(_TWO_DOTS)
    most = near.sum(axis=1) == near.sum(axis=1).max()
    usual = near[most].any(axis=0)
    lengths = np.array([spot.length for spot in alone])
    return float(np.median(areas[usual])), float(np.median(lengths[usual]))


def _two_dots(pixels: Array) -> Array:
    """(2, 2): the middles of two equal discs whose pixels (n, 2) these are.

    Discs that are d apart spread the pixels along their line by d^2 / 4 more than across it.
    """
    spread, axes = np.linalg.eigh(np.cov(pixels.T))
    half = np.sqrt(max(0.0, spread[1] - spread[0])) * axes[:, 1]
    middle = pixels.mean(axis=0)
    return np.array([middle - half, middle + half])


def name_dots(
    dots_px: Array, expected_px: Mapping[str, Array], *, furthest_px: float, sure_px: float
) -> dict[str, Array]:
    """Each expected dot's place (2,), by the assignment with the least sum of squared ways.

    Dots in a row keep their order so. NaN for one that nothing is near enough to, within
    `furthest_px`; and for all, when one is hidden while others moved farther than `sure_px`: a
    row with a gap may have moved up by one place, and a wrong name is worse than none.
    """
    names = list(expected_px)
    places = {name: np.full(2, np.nan) for name in names}
    if not len(dots_px):
        return places
    expected = np.array([expected_px[name] for name in names])
    apart_px = np.linalg.norm(expected[:, None] - dots_px, axis=2)
    # What is too far apart is no match at all, and costs the same however far it is.
    for row, column in zip(
        *linear_sum_assignment(np.minimum(apart_px, furthest_px) ** 2), strict=True
    ):
        if apart_px[row, column] <= furthest_px:
            places[names[row]] = dots_px[column]
    moved_px = [np.linalg.norm(places[name] - expected_px[name]) for name in names]
    if np.isnan(moved_px).any() and np.nanmax(moved_px, initial=0.0) > sure_px:
        return {name: np.full(2, np.nan) for name in names}
    return places


def dots_mm(places_px: Mapping[str, Array], origin_px: Array, mm_per_px: float) -> dict[str, Array]:
    """(3,) each: across to the robot's left, which is right in its picture, up, and 0 forward."""
    return {
        name: np.array([place[0] - origin_px[0], origin_px[1] - place[1], 0.0 * place[0]])
        * mm_per_px
        for name, place in places_px.items()
    }
