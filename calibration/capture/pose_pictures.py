"""Pictures in a folder, one a pose: `pose_7.png` is of pose 7."""

import re
from pathlib import Path
from typing import Final

from calibration.calibration import CalibrationError

#: What every reader here reads.
PICTURES: Final = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
#: What phones and cameras write besides, and nobody here reads.
_FOREIGN: Final = (".heic", ".heif", ".dng", ".cr2", ".nef", ".arw", ".webp", ".gif")


def pose_pictures(folder: Path) -> list[tuple[int, Path]]:
    """Pose and file, by name; none where there are none.

    Raises CalibrationError for a picture that names no pose, or is of a kind that is not read.
    """
    pictures = []
    for path in sorted(folder.iterdir()):
        ending = path.suffix.lower()
        if path.name.startswith(".") or ending not in (*PICTURES, *_FOREIGN):
            continue
        if ending in _FOREIGN:
            raise CalibrationError(f"{path}: {ending} is not read; save it as .jpg or .png")
        numbers = re.findall(r"\d+", path.stem)
        if not numbers:
            raise CalibrationError(f"{path}: no pose number in the name; call it pose_1.png")
        pictures.append((int(numbers[-1]), path))
    return pictures


def holds_pictures(folder: Path) -> bool:
    """Whether there is any picture in it, readable or not."""
    return any(path.suffix.lower() in (*PICTURES, *_FOREIGN) for path in folder.iterdir())
