"""The lips as a line drawing for a terminal, in Braille dots or in plain characters.

What is drawn is how far each lip marker has gone from rest, on a mouth that is closed, straight and
as wide on the left as on the right: no talker's own mouth is, nor is a head held quite level.
"""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from lipsync.markers import MARKERS_47

Array = NDArray[np.float64]
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

#: Markers of a lip follow one another round the mouth, beginning with a corner.
_OUTER = [i for i, name in enumerate(MARKERS_47.names) if name.startswith("outer_lip")]
_INNER = [i for i, name in enumerate(MARKERS_47.names) if name.startswith("inner_lip")]


def draw_mouth(markers_mm: Array, rest_mm: Array, *, ascii_only: bool = False) -> list[str]:
    """Lines of text, all of `MOUTH_COLUMNS`, that show both lips from the front.

    markers_mm: (47, 3); rest_mm: (47, 3), the same talker's closed mouth.
    """
    canvas = np.zeros((MOUTH_ROWS, MOUTH_COLUMNS), dtype=np.int64)
    moved_mm = (markers_mm - rest_mm)[:, :2]
    for loop, at_rest_mm in _neutral_lips(rest_mm):
        places_mm = at_rest_mm + moved_mm[loop] + [0.0, _ABOVE_MIDDLE_MM]
        for start, end in pairwise([*places_mm, places_mm[0]]):
            _draw_line(canvas, start, end)
    character = _ascii if ascii_only else _braille
    return ["".join(character(int(cell)) for cell in row) for row in canvas]


def _neutral_lips(rest_mm: Array) -> list[tuple[list[int], Array]]:
    """Each lip's markers, and where they are drawn at rest: (n, 2), from the middle of the mouth.

    The mean of the mouth and its mirror image, with the inner lips in one straight line.
    """
    outer = _symmetric(rest_mm[_OUTER, :2])
    inner = _symmetric(rest_mm[_INNER, :2])
    outer[:, 1] -= inner[:, 1].mean()
    outer[[0, len(outer) // 2], 1] = 0.0
    inner[:, 1] = 0.0
    return [(_OUTER, outer), (_INNER, inner)]


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
