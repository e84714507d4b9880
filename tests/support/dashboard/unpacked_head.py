"""What a web page reads of a packed head (`lipsync.twin.packed`)."""

import json
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np

from lipsync.arrays import Array32


def unpack(packed: bytes) -> dict[str, dict[str, Any]]:
    """Return a packed twin's parts by name: places, triangles and morph targets of each.

    `places_mm` (n, 3) and each of `morphs` by name (n, 3) are float32 in mm, as a page decodes
    them; `triangles` (n_triangles, 3) int64.
    """
    (length,) = struct.unpack_from("<I", packed)
    header = json.loads(packed[4 : 4 + length])
    body = packed[4 + length :]

    def array(entry: Mapping[str, Any]) -> Array32:
        values = np.frombuffer(body, dtype=entry["type"], count=entry["count"], offset=entry["at"])
        return (values.astype(np.float32) * np.float32(entry.get("step", 1.0))).reshape(-1, 3)

    return {
        part["name"]: {
            "places_mm": array(part["places"]),
            "triangles": array(part["triangles"]).astype(np.int64),
            "morphs": {each["name"]: array(each["moves"]) for each in part["morphs"]},
        }
        for part in header["parts"]
    }
