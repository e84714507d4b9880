"""The lips as a line drawing for a terminal, in Braille dots."""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from lipsync.markers import MARKER_NAMES

Array = NDArray[np.float64]

#: Dots of a Braille character by column and row, as bits above U+2800 (Unicode, block Braille).
_DOT_BITS = np.array([[0x01, 0x02, 0x04, 0x40], [0x08, 0x10, 0x20, 0x80]])
_MM_PER_DOT = 1.1
MOUTH_COLUMNS, _ROWS = 34, 12
#: Dots are this much closer together than one apart, so that lines have no holes.
_STEPS_PER_DOT = 2

_OUTER = [i for i, name in enumerate(MARKER_NAMES) if name.startswith("outer_lip")]
_INNER = [i for i, name in enumerate(MARKER_NAMES) if name.startswith("inner_lip")]


def draw_mouth(markers_mm: Array, centre_mm: Array) -> list[str]:
    """Lines of text that show both lips from the front.

    markers_mm: (47, 3); centre_mm: (3,), the point in the middle of the drawing.
    """
    canvas = np.zeros((_ROWS, MOUTH_COLUMNS), dtype=np.int64)
    for loop in (_OUTER, _INNER):
        # Markers of a lip follow one another round the mouth.
        corners = markers_mm[[*loop, loop[0]], :2] - centre_mm[:2]
        for start, end in pairwise(corners):
            _draw_line(canvas, start, end)
    return ["".join(chr(0x2800 + int(cell)) for cell in row) for row in canvas]


def _draw_line(canvas: NDArray[np.int64], start: Array, end: Array) -> None:
    """start, end: (2,) mm from the middle of the canvas, y up; what falls outside is left out."""
    dots = np.stack([start, end]) * [1.0, -1.0] / _MM_PER_DOT + [MOUTH_COLUMNS, 2 * _ROWS]
    n_steps = int(np.abs(dots[1] - dots[0]).max() * _STEPS_PER_DOT) + 2
    for x, y in np.floor(np.linspace(dots[0], dots[1], n_steps)).astype(int):
        if 0 <= x < 2 * MOUTH_COLUMNS and 0 <= y < 4 * _ROWS:
            canvas[y // 4, x // 2] |= _DOT_BITS[x % 2, y % 4]
