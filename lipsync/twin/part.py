"""What a twin is put together from: meshes with named morph targets, and eyeballs."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from lipsync.arrays import Array, Indices


@dataclass(frozen=True, slots=True)
class Part:
    """One mesh.

    places_mm (n, 3), triangles (n_triangles, 3), outward; colours (n, 3), 0 to 1, sRGB.
    morphs: displacements in mm (n, 3) of the targets that move it, by name. It turns with the head
    unless it `stays`.
    """

    name: str
    places_mm: Array
    triangles: Indices
    colours: Array
    morphs: Mapping[str, Array] = field(default_factory=dict)
    stays: bool = False


@dataclass(frozen=True, slots=True)
class Eyeball:
    """A sphere that turns about its centre (3,); it looks straight ahead along z."""

    side: Literal["left", "right"]
    centre_mm: Array
    radius_mm: float
    iris_radius_mm: float
