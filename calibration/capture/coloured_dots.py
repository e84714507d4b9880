"""Coloured dots on a face, found in pictures from the front: one picture a pose.

A single camera sees across and up; forward is given as 0, so the calibration learns nothing of it.
Needs OpenCV, the extra `video`; imported only when pictures are read. Loads SciPy.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import linear_sum_assignment

from calibration.calibration import CalibrationError
from lipsync.arrays import Array
from lipsync.extras import check_extra

#: Dots are of one size: a spot larger than this many of the middle one is two dots that touch, as
#: those of closed lips do.
_ONE_DOT = 1.25


@dataclass(frozen=True, slots=True)
class DotColour:
    """A range of OpenCV's hue 0..179, and the least saturation and brightness, 0..255.

    The default is blue: neither skin, lips, nor most rubber.
    """

    least_hue: int = 100
    most_hue: int = 130
    least_saturation: int = 120
    least_brightness: int = 60


def find_dots_px(picture: Path, colour: DotColour, *, least_area_px: int = 12) -> Array:
    """(n, 2): column and row of the middle of every dot of that colour.

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
    n_spots, spots, stats, middles = cv2.connectedComponentsWithStats(mask)
    areas = stats[:, cv2.CC_STAT_AREA]
    # The first is what is not a dot.
    large = [spot for spot in range(1, n_spots) if areas[spot] >= least_area_px]
    dots: list[Array] = []
    for spot in large:
        if areas[spot] > _ONE_DOT * np.median(areas[large]):
            dots.extend(_two_dots(np.argwhere(spots == spot)[:, ::-1].astype(np.float64)))
        else:
            dots.append(middles[spot])
    return np.array(dots, dtype=np.float64).reshape(-1, 2)


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
