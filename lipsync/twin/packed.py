"""A twin (a head for displays) as bytes for a web page: JSON header, then little-endian arrays.

The first four bytes are the length of the header (u32); arrays begin after it, at multiples of four
bytes, and the header gives the byte at which each begins, counted from the first array. Places are
float32 in mm; morph targets int16 times a step in mm, and the changes of the normals with them int8
times a step; colours and triangles are u8 and u16.
"""

import json
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array, Indices
from lipsync.markers import INNER_LIP, OUTER_LIP
from lipsync.twin.head_surface import FACE_RIM, LEFT_BROW, LEFT_EYE, RIGHT_BROW, RIGHT_EYE
from lipsync.twin.parts import Part
from lipsync.twin.twin import Twin

PACKED_VERSION = 1
#: Vertices of the skin along the lines of a simple drawing.
_LINES = {
    "rim": FACE_RIM,
    "outer_lip": OUTER_LIP,
    "inner_lip": INNER_LIP,
    "eye_left": LEFT_EYE,
    "eye_right": RIGHT_EYE,
    "brow_left": (*LEFT_BROW[0], *LEFT_BROW[1][::-1]),
    "brow_right": (*RIGHT_BROW[0], *RIGHT_BROW[1][::-1]),
    "nose": (168, 6, 197, 195, 5, 4, 1, 2),
}
_MOST = {np.dtype(np.int16): 32767, np.dtype(np.int8): 127}


def pack(twin: Twin) -> bytes:
    """Return a twin as bytes; the header's fields are those of `Twin`, `Part` and `Eyeball`."""
    body = Body()
    amounts = dict(zip(twin.components, twin.deviations.tolist(), strict=True))
    header = {
        "version": PACKED_VERSION,
        "components": twin.components,
        "rest": twin.rest.tolist(),
        "pivot_mm": twin.pivot_mm.tolist(),
        "lines": _LINES,
        "lip_gap": [INNER_LIP[5], INNER_LIP[15]],
        "eyes": [
            {
                "side": eye.side,
                "centre_mm": eye.centre_mm.tolist(),
                "radius_mm": eye.radius_mm,
                "iris_radius_mm": eye.iris_radius_mm,
            }
            for eye in twin.eyes
        ],
        "parts": [_part_entry(part, amounts, body) for part in twin.parts],
    }
    return body.behind(header)


class Body:
    """The arrays of a packed twin as bytes, one after another, at multiples of four bytes."""

    def __init__(self) -> None:
        self.pieces: list[bytes] = []
        self._length = 0

    def behind(self, header: Mapping[str, object]) -> bytes:
        """Return the packed twin: the length of the header, the header in JSON, all arrays."""
        text = json.dumps(header).encode()
        text += b" " * (-(4 + len(text)) % 4)
        return struct.pack("<I", len(text)) + text + b"".join(self.pieces)

    def add(self, values: NDArray[Any], kind: str) -> dict[str, object]:
        """Append an array as NumPy type `kind`; return its first byte, number of values, type."""
        data = np.ascontiguousarray(values, dtype=kind).tobytes()
        entry = {"at": self._length, "count": int(values.size), "type": kind}
        padded = data + b"\0" * (-len(data) % 4)
        self.pieces.append(padded)
        self._length += len(padded)
        return entry

    def add_scaled(self, values: Array, kind: str) -> dict[str, object]:
        """Append an array as whole numbers of type `kind` times a step.

        Return what `add` returns, and the step.
        """
        most = _MOST[np.dtype(kind)]
        step = max(float(np.abs(values).max()), 1e-9) / most
        return {**self.add(np.rint(values / step), kind), "step": step}


def _part_entry(part: Part, amounts: Mapping[str, float], body: Body) -> dict[str, object]:
    """Return a part's entry in the header; append the part's arrays to `body`.

    amounts: each component's standard deviation, by name, by which its change of the normals is
    computed; 1 for other morph targets.
    """
    normals = vertex_normals(part.places_mm, part.triangles)
    return {
        "name": part.name,
        "stays": part.stays,
        "places": body.add(part.places_mm, "<f4"),
        "triangles": body.add(part.triangles, "<u2"),
        "normals": body.add_scaled(normals, "<i2"),
        "colours": body.add(np.rint(part.colours * 255), "u1"),
        "morphs": [
            {
                "name": name,
                "moves": body.add_scaled(moves, "<i2"),
                "turns": body.add_scaled(_normal_rates(part, moves, amounts.get(name, 1.0)), "i1"),
            }
            for name, moves in part.morphs.items()
        ],
    }


def _normal_rates(part: Part, displacements: Array, amount: float) -> Array:
    """Return the change of a part's normals (n, 3) per unit of a morph target.

    displacements: the target's, (n, 3). The change is the difference between the normals at
    `amount` and at -`amount` of the target, divided by 2 `amount`.
    """
    normals_plus = vertex_normals(part.places_mm + amount * displacements, part.triangles)
    normals_minus = vertex_normals(part.places_mm - amount * displacements, part.triangles)
    return np.asarray((normals_plus - normals_minus) / (2 * amount), dtype=np.float64)


def vertex_normals(places: Array, triangles: Indices) -> Array:
    """Return a mesh's unit normals: of the triangles round each vertex, weighted by their area.

    Parameters
    ----------
    places : Array
        (n, 3), vertices.
    triangles : Indices
        (n_triangles, 3).

    Returns
    -------
    Array
        (n, 3).
    """
    corner = places[triangles]
    faces = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    summed = np.column_stack(
        [
            np.bincount(triangles.ravel(), np.repeat(faces[:, axis], 3), minlength=len(places))
            for axis in range(3)
        ]
    )
    length = np.linalg.norm(summed, axis=1, keepdims=True)
    return np.asarray(summed / np.maximum(length, 1e-12), dtype=np.float64)
