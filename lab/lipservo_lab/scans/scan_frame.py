"""Units and axes of scans, and how they become those of a face: millimetres, y up, z to the viewer.

Nothing is guessed silently: what looks like other units or axes is told with the option to give.
"""

from dataclasses import dataclass, field

import numpy as np

from lipsync.arrays import Array
from lipsync.errors import UserError

#: Millimetres of each unit that may be asked for.
UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4}
#: Twice the median distance from the middle: of a face alone about 130 mm, of head and shoulders
#: some 400. The first bound that it stays below names the unit.
_SIZES = ((1.0, "m"), (9.0, "in"), (45.0, "cm"), (900.0, "mm"))


class ScanFrameError(UserError):
    """Units or axes that cannot be used; one line."""


@dataclass(frozen=True)
class ScanFrame:
    """unit: of `UNITS_MM`. axes: three rows, which axis of the scan, signed, is x, y, z of a face.

    A face has x to the picture's right, y up, z out of it to the viewer.
    """

    unit: str = "mm"
    axes: Array = field(default_factory=lambda: np.eye(3))

    def in_mm(self, points: Array) -> Array:
        """(n, 3) as the scanner has them -> as a face has them."""
        return np.asarray(UNITS_MM[self.unit] * points @ self.axes.T, dtype=np.float64)


def scan_frame(unit: str, axes: str) -> ScanFrame:
    """axes: such as `x,y,z`, `x,z,-y`: the scan's axes to the right, up, and to the viewer.

    Raises ScanFrameError.
    """
    if unit not in UNITS_MM:
        raise ScanFrameError(f"unit {unit!r}: one of {', '.join(UNITS_MM)}")
    rows = np.zeros((3, 3))
    named = [each.strip().lower() for each in axes.split(",")]
    letters = [each.removeprefix("-").removeprefix("+") for each in named]
    if sorted(letters) != ["x", "y", "z"]:
        raise ScanFrameError(f"axes {axes!r}: name each of x, y and z once, such as x,z,-y")
    for row, (name, letter) in enumerate(zip(named, letters, strict=True)):
        rows[row, "xyz".index(letter)] = -1.0 if name.startswith("-") else 1.0
    return ScanFrame(unit, rows)


def axes_text(axes: Array) -> str:
    """As `scan_frame` reads them."""
    at = np.abs(axes).argmax(axis=1)
    return ",".join(("-" if axes[row, i] < 0 else "") + "xyz"[i] for row, i in enumerate(at))


def check_unit(points_mm: Array, unit: str, name: str) -> None:
    """Raises ScanFrameError for points whose size says that their unit is another one."""
    spread = 2.0 * float(
        np.median(np.linalg.norm(points_mm - np.median(points_mm, axis=0), axis=1))
    )
    size = spread / UNITS_MM[unit]
    looks_like = next((each for bound, each in _SIZES if size < bound), None)
    if 60.0 < spread < _SIZES[-1][0]:
        return
    if looks_like is None or looks_like == unit or size <= 0.0:
        raise ScanFrameError(
            f"{name}: half of its points lie in {spread:.3g} mm, which is no face; scale the scans "
            "to millimetres"
        )
    raise ScanFrameError(
        f"{name}: half of its points lie in {size:.3g} {unit}: it is in "
        f"{ {'m': 'metres', 'in': 'inches', 'cm': 'centimetres', 'mm': 'millimetres'}[looks_like] }"
        f"; give --unit {looks_like}"
    )
