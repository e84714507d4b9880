"""The face shipped with the program: a picture of the twin, its own head, not of a person."""

from importlib import resources
from typing import Final

import numpy as np

from lipservo.display.photo_face import PhotoFace, photo_face
from lipservo.display.photo_file import Landmarks, framed, read_photo
from lipsync.face.model import FaceModel, load_face
from lipsync.twin.head_surface import N_SKIN
from lipsync.twin.twin import make_twin

#: Of twin.jpg, which `lipservo_lab.twin_making.twin_picture` draws: its size, and where the origin
#: of the head lies in it, a pixel's middle at whole numbers.
TWIN_SIZE: Final = (960, 720)
TWIN_PX_PER_MM: Final = 2.5
TWIN_AT_PX: Final = (479.5, 285.5)


def twin_face(face: FaceModel, size: tuple[int, int]) -> PhotoFace:
    """Return the shipped picture, in `size` (px), to be moved by a model. Raises TwinError."""
    with resources.as_file(resources.files("lipservo.display") / "twin.jpg") as path:
        picture, _ = read_photo(path)
    return photo_face(*framed(picture, twin_landmarks(), size), face)


def twin_landmarks() -> Landmarks:
    """Return the landmarks in the shipped picture, in px: of the default model's head at rest."""
    skin = (twin := make_twin(load_face())).parts[0]
    places = skin.places_mm[:N_SKIN].copy()
    for name, amount in zip(twin.components, twin.rest.tolist(), strict=True):
        places += amount * skin.morphs[name][:N_SKIN]
    in_picture = places * (TWIN_PX_PER_MM, -TWIN_PX_PER_MM, -TWIN_PX_PER_MM) + (*TWIN_AT_PX, 0.0)
    return dict(enumerate(np.asarray(in_picture)))
