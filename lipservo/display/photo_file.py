"""Photographs and their landmarks from files, for a film.

Pictures of any kind and orientation are returned upright, in red, green and blue, no larger than a
film needs.
"""

import json
import os.path
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lipservo.display.photo_face import HAND_POINTS, PhotoError
from lipsync.arrays import Array
from lipsync.errors import check_extra
from lipsync.markers import N_LANDMARKS
from lipsync.video.face_detection import Picture
from lipsync.video.face_tracker import FaceTracker

#: A picture larger than this is no photograph of one face; unpacked it would fill the memory.
_MOST_PIXELS = 120_000_000
_LEAST_SIDE_PX = 64
#: Larger ones are brought to this: a face in a film has fewer pixels.
_LONGEST_SIDE_PX = 1920
_MOST_JSON_BYTES = 1_000_000
#: Where the middle of the face comes in a cut picture, as portraits are cut.
_MIDDLE = np.array([0.5, 0.55])
#: Behind what is transparent.
_BACKING = (226, 231, 236)

_WITH_ALPHA = ("LA", "PA", "RGBA", "La", "RGBa")
#: The tag of EXIF that says how the camera was held, and its values of a quarter turn; others than
#: 1 to 8 mean nothing (EXIF 2.32, 4.6.4).
_ORIENTATION, _TURNED = 0x0112, (5, 6, 7, 8)

Landmarks = Mapping[int, Array]


def read_photo(path: Path) -> tuple[Picture, float]:
    """Return a photograph, upright, RGB, at most 1920 px long, and its scale.

    The scale is the width of the returned picture over the upright width in the file. Raises
    PhotoError, MissingExtraError.
    """
    if not os.path.isfile(path):  # of a name that is too long Path raises
        raise PhotoError(f"{str(path)[:200]!r}: no such file")
    check_extra("PIL", "reading a photograph")
    from PIL import Image, ImageOps

    # Pillow warns of large pictures; here they are refused, before anything is unpacked.
    limit, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None
    try:
        with Image.open(path) as image:
            width, height = image.size
            if width * height > _MOST_PIXELS:
                raise PhotoError(
                    f"{path}: {width} x {height} pixels; {_MOST_PIXELS // 10**6} million at most"
                )
            if min(width, height) < _LEAST_SIDE_PX:
                raise PhotoError(
                    f"{path}: {width} x {height} pixels; both sides need {_LEAST_SIDE_PX}"
                )
            longest = _LONGEST_SIDE_PX
            image.draft("RGB", (longest, longest))  # a JPEG is unpacked no larger than needed
            upright = ImageOps.exif_transpose(image)
            is_turned = image.getexif().get(_ORIENTATION, 1) in _TURNED
            rgb = _red_green_blue(upright)
            rgb.thumbnail((longest, longest), Image.Resampling.LANCZOS)
            return np.asarray(rgb).copy(), rgb.width / (height if is_turned else width)
    except FileNotFoundError:
        raise PhotoError(f"{path}: no such file") from None
    except (OSError, ValueError, SyntaxError) as error:
        if isinstance(error, PhotoError):
            raise
        raise PhotoError(f"{path}: cannot be read as a picture; save it as JPEG or PNG") from error
    finally:
        Image.MAX_IMAGE_PIXELS = limit


def _red_green_blue(image: Any) -> Any:
    """Convert a Pillow image of any mode to RGB, with a plain colour behind transparent parts."""
    from PIL import Image

    if "transparency" in image.info or image.mode in _WITH_ALPHA:
        over = Image.new("RGBA", image.size, (*_BACKING, 255))
        return Image.alpha_composite(over, image.convert("RGBA")).convert("RGB")
    if image.mode.startswith(("I", "F")):  # 16 and 32 bits of grey
        values = np.asarray(image, dtype=np.float64)
        image = Image.fromarray((255 * values / max(values.max(), 1.0)).astype(np.uint8))
    return image.convert("RGB")


def tracked(picture: Picture, tracker: FaceTracker, name: str) -> Landmarks:
    """Return the landmarks of the one face in a picture, in pixels.

    Raises PhotoError for no face, or several; `name` is the picture's in the message.
    """
    faces = tracker.faces(picture)
    if not faces:
        raise PhotoError(
            f"{name}: no face is found; take it from the front in good light, or set its points by "
            "hand (--landmarks)"
        )
    if len(faces) > 1:
        raise PhotoError(f"{name}: {len(faces)} faces are found; cut the picture to one of them")
    return dict(enumerate(faces[0] - (0.5, 0.5, 0.0)))  # a tracker counts from a pixel's corner


def read_landmarks(path: Path, share: float) -> Landmarks:
    """Read landmarks from a JSON file: `{"points_px": {"nose_tip": [x, y], ...}}`.

    Keys are names of `HAND_POINTS` or numbers of the 478-point face mesh; values are pixels of the
    photograph's file, with z (away from the viewer) if known. share: the scale from `read_photo`,
    by which they are multiplied. Raises PhotoError.
    """
    try:
        if path.stat().st_size > _MOST_JSON_BYTES:
            raise PhotoError(f"{path}: this file is too large for points of a face")
        points = json.loads(path.read_text(encoding="utf-8"))["points_px"]
    except OSError as error:
        raise PhotoError(f"{path}: cannot be read ({error.strerror})") from error
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise PhotoError(f"{path}: {_points_error_text(error)}") from error
    try:
        return {number: _scaled(place, share) for number, place in landmarks_of(points).items()}
    except PhotoError as error:
        raise PhotoError(f"{path}: {error}") from error


def landmarks_of(points: object) -> Landmarks:
    """Return landmarks from unchecked JSON, {name or number: [x, y] or [x, y, z]}.

    Raises PhotoError, whose message names no file.
    """
    try:
        named = dict(points)  # type: ignore[call-overload]
        found = {_number(name): np.array(place, dtype=np.float64) for name, place in named.items()}
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise PhotoError(_points_error_text(error)) from error
    for number, place in found.items():
        if place.shape not in ((2,), (3,)) or not np.isfinite(place).all():
            raise PhotoError(f"landmark {number} must be [x, y] or [x, y, z]")
    missing = [name for name, number in HAND_POINTS.items() if number not in found]
    if missing:
        raise PhotoError(f"landmarks are missing: {', '.join(missing)}")
    return found


def _points_error_text(error: Exception) -> str:
    """Return the error text for a file without usable points; it shows the form wanted."""
    return (
        f'no points of a face ({error}); write {{"points_px": {{"nose_tip": [x, y], ...}}}}, '
        "names: " + ", ".join(HAND_POINTS)
    )


def framed(
    picture: Picture, landmarks: Landmarks, size: tuple[int, int]
) -> tuple[Picture, Landmarks]:
    """Return a picture and its landmarks, cut and scaled to `size`, (width, height) px.

    The face is in the middle, as far as the picture has room.
    """
    import cv2

    height, width = picture.shape[:2]
    scale = max(size[0] / width, size[1] / height)
    if scale < 0.6:  # fewer pixels than there are: each is the mean of those that it covers
        half = (width // 2, height // 2)
        smaller = cv2.resize(
            picture[: 2 * half[1], : 2 * half[0]], half, interpolation=cv2.INTER_AREA
        )
        return framed(
            np.asarray(smaller, dtype=np.uint8),
            {n: _scaled(at, 0.5) for n, at in landmarks.items()},
            size,
        )
    middle = np.mean([place[:2] for place in landmarks.values()], axis=0)
    # How far the corner of the cut may move, and the affine map of the cut; a pixel's middle is at
    # whole numbers.
    room = np.maximum(np.array([width, height]) - np.array(size) / scale, 0.0)
    corner = np.clip(middle - _MIDDLE * np.array(size) / scale, 0.0, room)
    shift = scale * (0.5 - corner) - 0.5
    matrix = np.array([[scale, 0.0, shift[0]], [0.0, scale, shift[1]]])
    framed_picture = cv2.warpAffine(
        picture, matrix, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
    )
    framed_landmarks = {
        number: np.concatenate([scale * place[:2] + shift, scale * place[2:]])
        for number, place in landmarks.items()
    }
    return np.asarray(framed_picture, dtype=np.uint8), framed_landmarks


def _number(name: str) -> int:
    """Return the number of a landmark, given as a name of `HAND_POINTS` or as digits.

    Raises ValueError for a number that the face mesh lacks, or text that is neither.
    """
    number = HAND_POINTS[name] if name in HAND_POINTS else int(name)
    if not 0 <= number < N_LANDMARKS:
        raise ValueError(f"there is no landmark {number}")
    return number


def _scaled(place: Array, share: float) -> Array:
    """Return a landmark's place in a picture that is scaled by `share`.

    A pixel's middle is at whole numbers; a depth, if given, is scaled as well.
    """
    return np.concatenate([(place[:2] + 0.5) * share - 0.5, place[2:] * share])
