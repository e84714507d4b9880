"""Coloured dots on a face, found in pictures from the front: one picture a pose.

A single camera sees across and up; forward is given as 0, so the calibration learns nothing of it.
Needs OpenCV, the extra `video`; imported only when pictures are read. Loads SciPy.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from calibration.calibration import CalibrationError

Array = NDArray[np.float64]


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

    Raises CalibrationError for what is not a picture, or without OpenCV.
    """
    try:
        import cv2
    except ImportError:
        raise CalibrationError(
            f"{picture}: finding dots needs OpenCV; `pip install 'lipservo[video]'`"
        ) from None
    pixels = cv2.imread(str(picture))
    if pixels is None:
        raise CalibrationError(f"{picture}: not readable as a picture")
    low = (colour.least_hue, colour.least_saturation, colour.least_brightness)
    high = (colour.most_hue, 255, 255)
    mask = cv2.inRange(cv2.cvtColor(pixels, cv2.COLOR_BGR2HSV), np.array(low), np.array(high))
    _, _, stats, middles = cv2.connectedComponentsWithStats(mask)
    areas = stats[1:, cv2.CC_STAT_AREA]  # the first is what is not a dot
    return np.asarray(middles[1:][areas >= least_area_px], dtype=np.float64)


def name_dots(
    dots_px: Array, expected_px: Mapping[str, Array], *, furthest_px: float
) -> dict[str, Array]:
    """Each expected dot's place (2,), by the assignment with the least sum of squared ways.

    NaN for one that nothing is near enough to, within `furthest_px`.
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
    return places


def dots_mm(places_px: Mapping[str, Array], origin_px: Array, mm_per_px: float) -> dict[str, Array]:
    """(3,) each: across to the robot's left, which is right in its picture, up, and 0 forward."""
    return {
        name: np.array([place[0] - origin_px[0], origin_px[1] - place[1], 0.0 * place[0]])
        * mm_per_px
        for name, place in places_px.items()
    }
