"""The lips as a line drawing for a terminal, in Braille dots or in plain characters.

What is drawn is how far each lip marker has gone from rest, on a mouth that is closed, straight and
as wide on the left as on the right: no speaker's own mouth is, nor is a head held quite level.
"""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array
from lipsync.markers import INNER_LIP_GROUP, OUTER_LIP_GROUP, PointLayout

Canvas = NDArray[np.int64]

#: Dots of a Braille character by column and row, as bits above U+2800 (Unicode, block Braille).
_DOT_BITS = np.array([[0x01, 0x02, 0x04, 0x40], [0x08, 0x10, 0x20, 0x80]])
_UPPER_BITS = 0x01 | 0x02 | 0x08 | 0x10
_MM_PER_DOT = 1.1
MOUTH_COLUMNS, MOUTH_ROWS = 34, 12
#: Dots are this much closer together than one apart, so that lines have no holes.
_STEPS_PER_DOT = 2
#: The mouth opens downwards: the closed one is drawn so far above the middle.
_ABOVE_MIDDLE_MM = 8.0


def draw_mouth(
    markers_mm: Array, rest_mm: Array, layout: PointLayout, *, ascii_only: bool = False
) -> list[str]:
    """Lines of text, all of `MOUTH_COLUMNS`, that show both lips from the front.

    markers_mm: (n_points, 3); rest_mm: (n_points, 3), the same speaker's closed mouth. Of the
    layout are drawn the lips that it has.
    """
    canvas = np.zeros((MOUTH_ROWS, MOUTH_COLUMNS), dtype=np.int64)
    moved_mm = (markers_mm - rest_mm)[:, :2]
    for loop, at_rest_mm in _neutral_lips(rest_mm, layout):
        places_mm = at_rest_mm + moved_mm[loop] + [0.0, _ABOVE_MIDDLE_MM]
        for start, end in pairwise([*places_mm, places_mm[0]]):
            _draw_line(canvas, start, end)
    character = _ascii if ascii_only else _braille
    return ["".join(character(int(cell)) for cell in row) for row in canvas]


def _neutral_lips(rest_mm: Array, layout: PointLayout) -> list[tuple[list[int], Array]]:
    """Each lip's markers, and where they are drawn at rest: (n, 2), from the middle of the mouth.

    The mean of the mouth and its mirror image, with the inner lips in one straight line.
    """
    around = [list(layout.group(name)) for name in (OUTER_LIP_GROUP, INNER_LIP_GROUP)]
    loops = [(points, _symmetric(rest_mm[points, :2])) for points in around if points]
    if not loops:
        return []
    # The innermost loop is the line where the lips meet.
    middle_mm = loops[-1][1][:, 1].mean()
    for _, places_mm in loops:
        places_mm[:, 1] -= middle_mm
        places_mm[[0, len(places_mm) // 2], 1] = 0.0
    if around[1]:
        loops[-1][1][:, 1] = 0.0
    return loops


def _symmetric(places_mm: Array) -> Array:
    """(n, 2): round a lip, the marker k from one corner mirrors the one k from the other."""
    n = len(places_mm)
    mirrored = places_mm[(n // 2 - np.arange(n)) % n]
    return np.stack(
        [
            (places_mm[:, 0] - mirrored[:, 0]) / 2.0,
            (places_mm[:, 1] + mirrored[:, 1]) / 2.0,
        ],
        axis=1,
    )


def _braille(cell: int) -> str:
    return chr(0x2800 + cell)


def _ascii(cell: int) -> str:
    above, below = cell & _UPPER_BITS, cell & ~_UPPER_BITS
    return ":" if above and below else "'" if above else "." if below else " "


def _draw_line(canvas: Canvas, start: Array, end: Array) -> None:
    """start, end: (2,) mm from the middle of the canvas, y up; what falls outside is left out."""
    dots = np.stack([start, end]) * [1.0, -1.0] / _MM_PER_DOT + [MOUTH_COLUMNS, 2 * MOUTH_ROWS]
    n_steps = int(np.abs(dots[1] - dots[0]).max() * _STEPS_PER_DOT) + 2
    for x, y in np.floor(np.linspace(dots[0], dots[1], n_steps)).astype(int):
        if 0 <= x < 2 * MOUTH_COLUMNS and 0 <= y < 4 * MOUTH_ROWS:
            canvas[y // 4, x // 2] |= _DOT_BITS[x % 2, y % 4]
