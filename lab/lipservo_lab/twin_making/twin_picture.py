"""`python -m lipservo_lab.twin_making.twin_picture OUT.jpg`: make the shipped picture of the twin.

The digital twin of the shipped model with closed lips, seen from far in front, lit as in the page.
`--face twin` warps it: it shows no real person. `lipservo/display/shipped_faces.py` says how large
a millimetre is in it, and where its middle is.
"""

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lipservo.display.raster import covered
from lipservo.display.shipped_faces import TWIN_AT_PX, TWIN_PX_PER_MM, TWIN_SIZE
from lipsync.arrays import Array, Indices
from lipsync.face.model import load_face
from lipsync.twin.packed import vertex_normals
from lipsync.twin.parts import Eyeball
from lipsync.twin.twin import Twin, make_twin

#: The picture is drawn this many times larger, then reduced.
_FINE = 3
#: Direction, strength and colour of each lamp, x right, y up, z to the viewer; as head.js has them.
_LAMPS = (
    ((-350.0, 420.0, 600.0), 0.62, (1.0, 0.96, 0.91)),
    ((500.0, 120.0, 400.0), 0.22, (0.91, 0.94, 1.0)),
    ((200.0, 300.0, -500.0), 0.3, (1.0, 1.0, 1.0)),
)
_SKY, _GROUND = np.array([0.52, 0.52, 0.53]), np.array([0.34, 0.29, 0.27])
_SHINE, _SHARPNESS = 0.10, 18.0
_BACKGROUND = np.array([[0.80, 0.85, 0.90], [0.62, 0.69, 0.76]])
#: Colours of pupil, iris, its ring and the white, sRGB.
_EYE = ((0.04, 0.04, 0.05), (0.40, 0.52, 0.52), (0.16, 0.22, 0.26), (0.92, 0.90, 0.88))


def twin_picture() -> Array:
    """Return the picture of the shipped twin, (height, width, 3), sRGB, 0 to 1."""
    twin = make_twin(load_face())
    width, height = (_FINE * each for each in TWIN_SIZE)
    share = np.linspace(0.0, 1.0, height)[:, None, None]
    linear = _linear((1 - share) * _BACKGROUND[0] + share * _BACKGROUND[1])
    picture = np.broadcast_to(linear, (height, width, 3)).copy()
    for vertices_mm, triangles, colours in _meshes(twin):
        at_px = vertices_mm[:, :2] * (TWIN_PX_PER_MM, -TWIN_PX_PER_MM) + TWIN_AT_PX
        fine = at_px * _FINE + (_FINE - 1) / 2
        normals = vertex_normals(vertices_mm, triangles)
        lit = _linear(colours) * _diffuse(normals) + _shine(normals)
        is_front = _outward(fine, triangles)
        visible = triangles[is_front]
        # Far triangles first: nearer ones are drawn over them.
        visible = visible[np.argsort(vertices_mm[visible, 2].mean(axis=1))]
        found = covered(fine[visible], height, width)
        picture[found.rows, found.columns] = found.interpolated(fine[visible], lit[visible]).T
    small = picture.reshape(height // _FINE, _FINE, width // _FINE, _FINE, 3).mean(axis=(1, 3))
    return np.asarray(_srgb(small), dtype=np.float64)


def _meshes(twin: Twin) -> list[tuple[Array, Indices, Array]]:
    """Return vertices (n, 3) mm, triangles and colours of each part at rest, from back to front."""
    parts = {part.name: part for part in twin.parts}
    rest = dict(zip(twin.components, twin.rest.tolist(), strict=True))
    found: list[tuple[Array, Indices, Array]] = []
    for name in ("neck", "lids_left", "lids_right", "skin"):
        part = parts[name]
        places = part.places_mm.copy()
        for target, moves in part.morphs.items():
            places += rest.get(target, 0.0) * moves
        if name == "lids_left":
            found += [_eye_mesh(eye) for eye in twin.eyes]
        found.append((places, part.triangles, part.colours))
    return found


def _eye_mesh(eye: Eyeball) -> tuple[Array, Indices, Array]:
    """Return an eyeball as vertices (n, 3) mm, triangles, and colours (n, 3): iris in front."""
    from trimesh.creation import icosphere

    ball = icosphere(subdivisions=5, radius=eye.radius_mm)
    places = np.asarray(ball.vertices)
    iris_radii = np.hypot(places[:, 0], places[:, 1]) / eye.iris_radius_mm
    iris_radii = np.where(places[:, 2] > 0, iris_radii, 9.0)
    knots = (0.0, 0.40, 0.46, 0.85, 0.98, 1.04, 1.5)
    pupil, iris, ring, white = (np.array(each) for each in _EYE)
    table = np.stack([pupil, pupil, iris, iris * 0.85, ring, white, white])
    colours = np.stack([np.interp(iris_radii, knots, column) for column in table.T], axis=1)
    return places + eye.centre_mm, np.asarray(ball.faces), colours


def _outward(fine: Array, triangles: Indices) -> NDArray[np.bool_]:
    """Return which triangles face the viewer.

    fine: vertices in pixels.
    """
    a, b, c = (fine[triangles[:, corner]] for corner in range(3))
    u, v = b - a, c - a
    return np.asarray(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0] < 0.0)


def _diffuse(normals: Array) -> Array:
    """Return the diffuse light on surfaces with these normals, (n, 3), linear RGB."""
    up = 0.5 + 0.5 * normals[:, 1:2]
    light = up * _SKY + (1 - up) * _GROUND
    for direction, strength, colour in _LAMPS:
        to_lamp = np.array(direction) / np.linalg.norm(direction)
        light = light + strength * np.clip(normals @ to_lamp, 0.0, None)[:, None] * np.array(colour)
    return np.asarray(light)


def _shine(normals: Array) -> Array:
    """Return the specular light of the first lamp, by Blinn and Phong, (n, 1)."""
    between = np.array(_LAMPS[0][0]) / np.linalg.norm(_LAMPS[0][0]) + (0.0, 0.0, 1.0)
    half = between / np.linalg.norm(between)
    return np.asarray(_SHINE * np.clip(normals @ half, 0.0, 1.0)[:, None] ** _SHARPNESS)


def _linear(colours: Array) -> Array:
    """Return sRGB colours as linear light, by a power of 2.2."""
    return np.asarray(np.asarray(colours) ** 2.2)


def _srgb(light: Array) -> Array:
    """Return linear light as sRGB, 0 to 1."""
    return np.asarray(np.clip(light, 0.0, 1.0) ** (1 / 2.2))


def main() -> None:
    """Write the picture to the path on the command line."""
    from PIL import Image

    Image.fromarray((255 * twin_picture()).astype(np.uint8)).save(Path(sys.argv[1]), quality=92)


if __name__ == "__main__":
    main()
